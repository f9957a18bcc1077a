"""Studio: people compare motion in a browser; pairs for DPO and the tables of user studies come of it (paper, Data Platform).

May import `engine`, `align` and below; `server` is a stranger.
"""
