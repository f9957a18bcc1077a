"""Music to motion: dances by rule and by captured people.

May import `capture`, `controls`, `keyframes`, `solver`, `sound` and `echoavatar`.
"""
