"""The generator in torch, and its training: windows of codes, corruption, losses, curriculum.

May import `tokens`, `published`, `data`, `training`, `nn`, `checkpoint` and `echoavatar`.
"""
