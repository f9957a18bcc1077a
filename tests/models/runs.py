"""What every training run must do: go on after a kill as if there had been none, and not depend on pieces."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from echoavatar_lab.training import Loop, TrainingTask


class KilledError(Exception):
    """The run ends here."""


def losses(folder: Path, key: str = "loss") -> dict[int, float]:
    """The loss, or another number, of each step that was logged."""
    lines = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
    return {line["step"]: line[key] for line in lines if key in line}


def check_resume(train: Callable[..., nn.Module], folder: Path, *, at: int) -> None:
    """`train(folder, progress=...)`, killed after step `at` and started again, ends as a whole run does, to the bit."""

    def kill(step: int, _: int) -> None:
        if step == at:
            raise KilledError

    whole = train(folder / "whole")
    with pytest.raises(KilledError):
        train(folder / "killed", progress=kill)
    killed = train(folder / "killed")
    assert losses(folder / "killed") == losses(folder / "whole")
    saved = [load_file(folder / name / "model.safetensors") for name in ("killed", "whole")]
    for one, other in ((killed.state_dict(), whole.state_dict()), saved):
        assert one.keys() == other.keys()
        assert all(torch.equal(one[key], other[key]) for key in other)


def check_pieces(make: Callable[[int], TrainingTask[Any]], pieces: int, *keys: str, steps: int = 5) -> list[Loop[Any]]:
    """A batch that passes in pieces gives the numbers of one that passes whole; returns both loops."""
    loops = [Loop(make(count)) for count in (1, pieces)]
    whole, parted = ([loop.advance() for _ in range(steps)] for loop in loops)
    for key in ("loss", *keys):
        np.testing.assert_allclose([told[key] for told in parted], [told[key] for told in whole], rtol=1e-4, atol=1e-5)
    return loops
