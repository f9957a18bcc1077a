"""Training of the generator: windows of codes, corruption, losses, curriculum.

May import `training` and `echoavatar`.
"""
