"""Captured people as material for the synthetic corpus: clips in `corpora.controls`, and walks through them.

`catalogue` says what the files show, `library` reads them, `controls_from_motion` is the inverse of the solver,
`motion_graph` joins clips to walks of any length, the body beneath gestures, `animated` reads what animators keyed,
`units` are single gestures. May import `controls`, `solver`, `keyframes`, `sound`, `data`, `foreign`, `kinematics` and
`echoavatar`.
"""
