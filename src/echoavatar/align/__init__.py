"""Reinforcement learning of the generator: rewards, rollouts, GRPO, DPO, PPO. May import `pipeline` and below.

Paper, Reinforcement Learning; docs/alignment.md tells how to use it.
"""
