"""The stages behind the tokenizer's decoder; `post` runs them in order.

May import `ik`, `kinematics`, `motion_chunk`, `nn` and below.
"""
