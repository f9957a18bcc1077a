"""Training of the generator: windows of codes, corruption, losses, curriculum.

May import `published`, `data`, `training` and `echoavatar`.
"""
