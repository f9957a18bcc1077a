"""Rehearsal: sound and motion made up by rule, so that training needs no foreign recordings.

Text, voices and music (`track`), their labels, and a choreographer that moves to them (`perform`, `solver`); `corpus`
puts them into clips. May import `audio`, `data`, `kinematics` and below. Every part is a function of its seed.
"""
