"""Studio: people compare motion in a browser, for DPO and for tables of user studies (paper, Data Platform).

May import `engine`, `align` and below; `server` is a stranger.
"""
