"""The face as modules of torch, and their training.

May import `training`, `nn`, `checkpoint`, `paper` and `echoavatar`.
"""
