"""Speech to motion by rule: gestures, head, standing and idling.

May import `capture`, `controls`, `solver` and `sound`.
"""
