"""Tunes the generator by reinforcement learning: rewards, rollouts, GRPO, DPO and PPO.

See the paper's section Reinforcement Learning; docs/alignment.md explains how to use it.

May import `evaluation` and below.
"""
