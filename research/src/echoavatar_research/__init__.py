"""The paper's tables, made again: one file per table, rows declared as data, one runner. `datasets` makes the sets,
`reference` reads the authors' release.

May import `evaluation` and below of `echoavatar`. `echoavatar` never imports it.
"""
