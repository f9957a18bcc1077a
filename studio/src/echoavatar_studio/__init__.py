"""The studio: people compare motion in a browser, for DPO and for tables of user studies (paper, Data Platform).

May import `engine`, `align` and below of `echoavatar`, but not `server`. `echoavatar` never imports it.
"""
