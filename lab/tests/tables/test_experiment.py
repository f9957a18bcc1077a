from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.tables.choices import OURS
from echoavatar_lab.tables.experiment import Experiment, is_mostly
from echoavatar_lab.tables.scale import PAPER


def test_the_papers_scale_wants_a_real_set(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="--corpus"):
        _ = Experiment(tmp_path, PAPER).corpus


def test_what_a_clip_is_mostly() -> None:
    domain = np.array([0, 1, 1, 2], np.uint8)
    clip = TokenClip(np.zeros((40, 2), int), np.zeros((4, 3, 2), int), domain)
    assert is_mostly(clip, None)
    assert is_mostly(clip, "speech")
    assert not is_mostly(clip, "music")


class Coder(torch.nn.Module):
    """Stands for an audio codec of one weight."""

    def __init__(self, weight: float) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor(weight))


def test_what_is_trained_on_codes_is_stamped_with_their_codec_and_tokenizer(tmp_path: Path) -> None:
    def settings(weight: float, digest: str = "a", seed: int = 0) -> dict[str, object]:
        experiment = Experiment(tmp_path, PAPER, seed=seed)
        experiment.__dict__.update(codec=Coder(weight), _digest=digest)  # cached properties
        return experiment.codes_settings(OURS)

    assert settings(1.0) == settings(1.0)
    assert settings(1.0) != settings(2.0)  # trained again in the same folder
    assert settings(1.0) != settings(1.0, digest="b")
    assert settings(1.0) != settings(1.0, seed=1)
