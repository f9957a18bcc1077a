"""The face as modules of torch, and their training. May import `training`, `paper` and `echoavatar`."""
