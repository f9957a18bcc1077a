"""Training of the models of `echoavatar.models`: windows, losses and tasks, one folder a model.

May import `data`, `training`, `foreign`, `held_folder`, `paper`, `progress` and `echoavatar`.
"""
