"""Training of the face. May import `training` and `echoavatar`."""
