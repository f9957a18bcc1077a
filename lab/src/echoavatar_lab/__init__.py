"""The lab: makes what the avatar runs, and keeps its modules of torch.

Data, corpora, training, evaluation, alignment and the tables of the paper. May import `echoavatar`, one file of
which asks for `torch_backend` by name. Its commands join `echoavatar` by entry points.
"""
