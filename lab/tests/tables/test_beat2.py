from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.evaluation.clips import clip, folder
from lab.tests.fakes import FakeExperiment

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data import Clip, Corpus
from echoavatar_lab.datasets import survey_of
from echoavatar_lab.foreign.smpl import read_smplx
from echoavatar_lab.kinematics import matrix_from_quaternion
from echoavatar_lab.tables import beat2
from echoavatar_lab.tables.beat2 import Beat2Experiment, write_sample
from echoavatar_lab.tables.experiment import Experiment, Sources
from echoavatar_lab.tables.scale import PAPER, TINY
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig


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


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("beat2")
    clips = [clip(f"c{n:02}", 64, size=0.1 + 0.02 * n) for n in range(16)]
    return write_sample(Corpus(folder(place / "corpus", clips, is_corpus=True)), place)


def beat2_experiment(place: Path, corpus: Path | None, **sources: Path) -> Beat2Experiment:
    return Beat2Experiment.of(Experiment(place, TINY, Sources(corpus, **sources), seed=1))


def test_a_copy_becomes_a_set_on_smplx_joints_and_is_kept(copy: Path, tmp_path: Path) -> None:
    made = beat2_experiment(tmp_path, copy)
    assert made.corpus.skeleton.joints == 55
    assert (made.folder, made.seed) == (tmp_path / "beat2", 1)
    assert len(made.test_clips) == 2
    before = (tmp_path / "beat2" / "set" / "manifest.json").stat().st_mtime_ns
    again = beat2_experiment(tmp_path, copy)
    assert again.corpus.names() == made.corpus.names()
    assert (tmp_path / "beat2" / "set" / "manifest.json").stat().st_mtime_ns == before
    prepared = beat2_experiment(tmp_path / "other", tmp_path / "beat2" / "set")
    assert prepared.corpus.folder == tmp_path / "beat2" / "set"


def test_positions_have_the_root_at_the_origin(copy: Path, tmp_path: Path) -> None:
    made = beat2_experiment(tmp_path, copy)
    places = made.positions(made.true_motions[0])
    assert places.shape == (64, 55, 3)
    assert float(np.abs(places[:, 0]).max()) == 0
    assert float(places[0, 15, 1]) == pytest.approx(
        float((HUMANOID.rest_positions[HUMANOID.index("head")] - HUMANOID.rest_positions[0])[1]), abs=0.05
    )


def test_a_set_on_our_rig_is_refused(tmp_path: Path) -> None:
    ours = folder(tmp_path / "ours", [clip("a"), clip("b")], is_corpus=True)
    with pytest.raises(EchoAvatarError, match="--rig native --fingers keep"):
        _ = beat2_experiment(tmp_path, ours).corpus


def test_the_papers_scale_wants_a_copy(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="beat_english_v2.0.0"):
        _ = Beat2Experiment.of(Experiment(tmp_path, PAPER)).corpus


def test_a_given_extractor_is_the_one_that_is_used(copy: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    theirs = SkeletonConvolution(SkeletonConvolutionConfig())
    theirs.save(tmp_path / "emage", {})
    made = beat2_experiment(tmp_path, copy, extractor=tmp_path / "emage")
    x = torch.randn(32, 330)
    np.testing.assert_allclose(made.extractor.features(x), theirs.eval().features(x))
    assert not (tmp_path / "beat2" / "extractor").exists()


def thrice(clip: Clip) -> Clip:
    """Long enough for EMAGE's cuts at both ends."""
    rotations, root = np.tile(clip.rotations, (3, 1, 1)), np.tile(clip.root, (3, 1))
    return replace(clip, audio=np.tile(clip.audio, 3), rotations=rotations, root=root, domain=np.tile(clip.domain, 3))


class FakeBeat2(FakeExperiment):
    """On our rig, some of whose joints stand for SMPL-X's thirteen."""

    sources, is_synthetic = Sources(), True

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
    still = replace(short, rotations=np.tile(short.rotations[:1], (frames, 1, 1))).motion()
    alone = {row.name: row.value for row in beat2.scored(experiment, experiment.true_motions)}
    mixed = {row.name: row.value for row in beat2.scored(experiment, [long.motion(), still])}
    assert mixed["l1_diversity"] == pytest.approx(0.75 * alone["l1_diversity"], rel=0.02)
