"""The stages behind the tokenizer's decoder; `post` runs them in order.

May import `motion.kinematics`, `motion.ik`, and `nn` and below.
"""
