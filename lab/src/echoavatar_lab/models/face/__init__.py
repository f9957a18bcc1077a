"""Training of the face. May import `training`, `paper` and `echoavatar`."""
