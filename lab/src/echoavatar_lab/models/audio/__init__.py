"""Training of the codec. May import `models`, `training` and `echoavatar`."""
