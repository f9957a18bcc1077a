from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.tables.experiment import Experiment, is_mostly, make_once
from echoavatar_lab.tables.scale import OURS, PAPER


def test_a_finished_part_is_kept_and_a_broken_one_made_again(tmp_path: Path) -> None:
    times = []

    def breaks() -> None:
        times.append("broken")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_once(tmp_path / "part", {"size": 1}, breaks)
    for _ in range(2):
        make_once(tmp_path / "part", {"size": 1}, lambda: times.append("whole"))
    assert times == ["broken", "whole"]


def test_a_part_of_other_settings_is_refused(tmp_path: Path) -> None:
    for _ in range(2):
        make_once(tmp_path / "part", {"size": (1, 2)}, lambda: None)
    with pytest.raises(EchoAvatarError, match="other settings"):
        make_once(tmp_path / "part", {"size": (1, 3)}, lambda: None)


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
