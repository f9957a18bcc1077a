"""The lab: makes what the avatar runs, and keeps its modules of torch.

Data, corpora, training, evaluation, alignment and the tables of the paper. May import `echoavatar`, in which one file
asks for `torch_backend`, and nothing else for the lab. Its commands join `echoavatar` by entry points.
"""
