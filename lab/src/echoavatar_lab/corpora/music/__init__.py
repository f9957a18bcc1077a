"""Music with exact labels: pieces composed by rule, their instruments, a beat tracker.

May import `sound` and `echoavatar`.
"""
