from pathlib import Path

import numpy as np
import torch
from lab.tests.evaluation.clips import clip, folder

from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar_lab.data import Corpus
from echoavatar_lab.datasets import survey_of
from echoavatar_lab.foreign.smplx_reader import read_smplx
from echoavatar_lab.tables.beat2_sample import write_sample


def test_the_sample_is_read_as_a_copy_of_beat2(tmp_path: Path) -> None:
    clips = [clip(f"c{n}", 90, size=0.1 + 0.05 * n) for n in range(9)]
    copy = write_sample(Corpus(folder(tmp_path / "corpus", clips, is_corpus=True)), tmp_path)
    found = survey_of("beat2", copy, speakers=["2"])
    assert [item.split for item in found.recordings].count("test") == 1
    assert {item.name: item.split for item in found.recordings}["2_scott_0_8_8"] == "test"
    assert not found.missing
    motion = read_smplx(found.recordings[0].motion)
    ours = clips[0].rotations[:, HUMANOID.index("spine")]
    theirs = motion.rotations[:, motion.skeleton.config.vrm["spine"]]
    same = (matrix_from_quaternion(torch.from_numpy(x)) for x in (ours, theirs))
    torch.testing.assert_close(*same, atol=1e-4, rtol=0)
    np.testing.assert_allclose(np.diff(motion.root, axis=0), np.diff(clips[0].root, axis=0), atol=1e-5)
    assert len(read_audio(found.recordings[0].sound)) == 90 * 800
