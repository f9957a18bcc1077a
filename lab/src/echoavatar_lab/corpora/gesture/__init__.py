"""Speech to motion by rule: gestures, head, standing and idling.

May import `capture`, `controls`, `keyframes`, `solver`, `sound` and `echoavatar`.
"""
