from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.fakes import FakeExperiment

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data import Clip
from echoavatar_lab.tables import beat2
from echoavatar_lab.tables.experiment import Sources, motion_of


def thrice(clip: Clip) -> Clip:
    """Long enough for EMAGE's cuts at both ends."""
    rotations, root = np.tile(clip.rotations, (3, 1, 1)), np.tile(clip.root, (3, 1))
    return replace(clip, audio=np.tile(clip.audio, 3), rotations=rotations, root=root, domain=np.tile(clip.domain, 3))


class FakeBeat2(FakeExperiment):
    """On our rig, some of whose joints stand for SMPL-X's thirteen."""

    sources, is_synthetic, motion = Sources(), True, staticmethod(motion_of)

    class extractor:  # noqa: N801  (an object, not a kind)
        @staticmethod
        def features(rotations: torch.Tensor) -> torch.Tensor:
            return rotations[::16, 1:300:40]

    class corpus:  # noqa: N801
        skeleton = HUMANOID

    def __init__(self) -> None:
        super().__init__()
        self.test_clips = [thrice(one) for one in self.test_clips]
        self.train_clips = [replace(one, split="train") for one in self.test_clips]

    def positions(self, motion):
        places = motion.pose().positions
        return places - places[:, :1]


def test_all_methods_of_the_paper_are_quoted_and_ours_are_measured() -> None:
    experiment = FakeBeat2()
    table = beat2.make(experiment)
    lines = {line.name: line for line in table.lines}
    assert experiment.asked == ["body-parts"]
    assert lines["EMAGE (quoted)"].paper == {"fid": 5.512, "ba_g": 7.724, "diversity": 13.06}
    assert not lines["EMAGE (quoted)"].ours
    assert lines["Ours"].paper["fid"] == 2.874
    assert lines["Real motion"].ours["fid"].value < 1e-6 < lines["Mean pose"].ours["fid"].value
    assert lines["Ours"].ours == lines["Real motion"].ours  # what was made is the truth here
    assert lines["Mean pose"].ours["ba_g"].value == 0
    assert lines["Mean pose"].ours["diversity"].value < 1e-3
    assert set(lines["Random clip"].ours) == {column.key for column in table.columns}
    assert "BEAT2's layout" in table.notes[0]


def test_the_extractor_that_was_used_is_told() -> None:
    experiment = FakeBeat2()
    assert "extractor of ours" in beat2.make(experiment).notes[1]
    experiment.sources = Sources(extractor=Path("weights/emage"))
    assert "the extractor in emage" in beat2.make(experiment).notes[1]


def test_each_clip_of_motion_counts_by_its_length() -> None:
    """Diversity of one clip alone and of one thrice as long beside a still one: three quarters of it."""
    experiment = FakeBeat2()
    long, short = experiment.test_clips[0], replace(experiment.test_clips[0])
    frames = long.frames // 3
    short = Clip("short", long.audio[: frames * 800], long.rotations[:frames], long.root[:frames], long.domain[:frames])
    experiment.test_clips = [long, short]
    still = motion_of(replace(short, rotations=np.tile(short.rotations[:1], (frames, 1, 1))))
    alone = {row.name: row.value for row in beat2.scored(experiment, [motion_of(long), motion_of(short)])}
    mixed = {row.name: row.value for row in beat2.scored(experiment, [motion_of(long), still])}
    assert mixed["l1_diversity"] == pytest.approx(0.75 * alone["l1_diversity"], rel=0.02)
