"""Training of the codec. May import `training` and `echoavatar`."""
