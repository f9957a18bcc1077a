"""The lab: makes what the avatar runs. Data, corpora, training, evaluation, alignment and the tables of the paper.

May import `echoavatar`; nothing of `echoavatar` imports it. Its commands join `echoavatar` by entry points.
"""
