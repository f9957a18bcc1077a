"""Files of other programs: exports, the character with its pictures and films, imports of the authors' release.

May import `engine` and below.
"""
