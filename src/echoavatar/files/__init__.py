"""Files of other programs: exports, the character with its pictures and films, readers of foreign arrays.

May import `engine` and below.
"""
