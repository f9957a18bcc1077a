"""A model soup: the weights of runs that began at one generator, mixed.

The mix is start + sum of w (run - start), after Wortsman et al., "Model soups" and "Robust fine-tuning of zero-shot
models". Runs that began at the same weights lie close enough for that. Shares that sum to less than 1 take back a part
of the tuning, so a soup also chooses between what a reward gains and what it costs. Not in the paper.
"""

from collections.abc import Mapping

import torch

from echoavatar.models.generator import Generator

from .policy import check_reference


@torch.no_grad()
def soup(start: Generator, runs: Mapping[str, tuple[Generator, float]]) -> Generator:
    """A new generator with `start`'s config. `runs` holds each tuned generator and its share, by name.

    Raises:
        CheckpointError: the codes of a run mean something else than `start`'s.
    """
    mixed = Generator(start.config)
    weights = {name: value.clone() for name, value in start.state_dict().items()}
    for run, (tuned, share) in runs.items():
        check_reference(start, tuned, name=run, what="run")
        theirs = tuned.state_dict()
        for name, value in start.state_dict().items():
            weights[name] += share * (theirs[name] - value)
    mixed.load_state_dict(weights)
    return mixed.eval()
