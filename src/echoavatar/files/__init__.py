"""Files for other programs: exports of motion, and the character with its films and pages.

May import `engine` and below.
"""
