from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.evaluation.clips import clip, folder

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data import Corpus
from echoavatar_lab.tables.beat2_experiment import Beat2Experiment
from echoavatar_lab.tables.beat2_sample import write_sample
from echoavatar_lab.tables.experiment import Experiment, Sources
from echoavatar_lab.tables.scale import PAPER, TINY
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig


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
    places = made.positions(made.motion(made.test_clips[0]))
    assert places.shape == (64, 55, 3)
    assert float(places[:, 0].abs().max()) == 0
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
