"""Tuning by many continuations at once, on a GPU: measured in batches, paid until targets are met. Not in the paper.

`echoavatar align grpo` judges one motion after another, with any function of a motion. `echoavatar align targets` is
made of this room. It decodes and measures all continuations of a step together in torch: 512 of ten seconds take half a
second on a GPU. Rewards are not weighed by hand: a weight grows while its mean is short of its target. The loop, the
loss, resuming and checkpoints are those of `echoavatar_lab.align`.

Reading order: `positions`, `timing`, `movement` (what is measured), `opponent`, `targets`, `goals` (what is wanted),
`judge` (what is paid), `task`. May import `echoavatar_lab.align` and below.
"""
