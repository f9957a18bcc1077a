"""Training of the finger model. May import `training` and `echoavatar`."""
