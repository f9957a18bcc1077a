"""The paper's tables, made again: one file a table, rows declared as data, one runner.

May import `evaluation` and below; only the command line imports it.
"""
