"""Training of the motion tokenizer and of its decoder. May import `data`, `training` and `echoavatar`."""
