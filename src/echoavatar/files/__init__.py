"""Files for other programs: exports of motion, and the character with its films and web pages.

May import `engine` and below.
"""
