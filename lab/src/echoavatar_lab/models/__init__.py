"""The models as modules of torch, their training and their export, one folder a model.

May import `data`, `training`, `foreign`, `nn`, `checkpoint`, `held_folder`, `paper`, `progress` and `echoavatar`.
"""
