"""The codec in torch, and its training.

May import `models`, `foreign`, `training`, `nn`, `checkpoint` and `echoavatar`.
"""
