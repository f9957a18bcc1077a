"""The paper's tables, made again: one file a table, rows declared as data, one runner.

May import `align`, `datasets`, `evaluation` and below.
"""
