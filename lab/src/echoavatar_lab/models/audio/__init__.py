"""Training of the codec. May import `models`, `foreign`, `training` and `echoavatar`."""
