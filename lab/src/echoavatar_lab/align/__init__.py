"""Tunes the generator by reinforcement learning: rewards, rollouts, GRPO, DPO and PPO. May import `pipeline` and below.

See the paper's section Reinforcement Learning; docs/alignment.md explains how to use it.
"""
