"""How a bundle wants to be run travels beside its checkpoints."""

import numpy as np
import pytest
import torch

from echoavatar.engine import Engine, animate
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.runtime import ADDITIONS, Runtime
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.stages.post import SWITCHES
from echoavatar.timing import CHUNK_SAMPLES


def test_without_the_file_everything_is_as_ours(tmp_path):
    assert Runtime.load(tmp_path) == Runtime()
    assert Runtime().stages == ("warp", *SWITCHES)


def test_it_comes_back(tmp_path):
    own = Runtime(level_control=False, silent_temperature=1.0, lead_in_s=0.5, stages=("smoother",))
    own.save(tmp_path)
    assert Runtime.load(tmp_path) == own


def test_the_pipeline_obeys(tiny_bundle):
    from dataclasses import replace

    bundle = replace(load_bundle(tiny_bundle), runtime=Runtime(level_control=False, stages=("smoother",)))
    assert Pipeline(bundle).level is None
    assert Pipeline(bundle).post.stages == {"smoother"}
    assert Pipeline(bundle, stages=("feet",)).post.stages == {"feet"}


def test_a_damaged_file_is_named(tmp_path):
    (tmp_path / "runtime.json").write_text('{"level_control": 3.5}')
    with pytest.raises(CheckpointError, match=r"runtime\.json: level_control"):
        Runtime.load(tmp_path)


def test_the_papers_runtime_has_nothing_of_ours() -> None:
    paper = Runtime().chosen("paper")
    assert paper.additions == ()
    assert paper.label == "paper"
    assert not paper.level_control
    assert paper.lead_in_s == 0
    assert paper.cylinder
    assert paper.silent_temperature == 1


def test_every_addition_has_a_switch() -> None:
    assert Runtime().label == "default"
    assert Runtime().additions == ADDITIONS
    for name in ADDITIONS:
        assert Runtime().chosen(name).label == name
        assert Runtime().chosen("paper").chosen(name).label == name  # also where the bundle has it off
    kept = Runtime(lead_in_s=0.5).chosen("lead-in,hands")
    assert (kept.label, kept.lead_in_s, kept.cylinder) == ("lead-in,hands", 0.5, False)
    with pytest.raises(EchoAvatarError, match="no runtime 'breath'.*idle"):
        Runtime().chosen("breath")


def test_a_subset_is_told_and_comes_back() -> None:
    chosen = Runtime().chosen("feet, ground")
    assert Runtime().chosen(chosen.label) == chosen


def test_without_ours_a_body_in_silence_does_not_breathe(tiny_bundle):
    """The session shows what the pipeline made, bit for bit; with idle motion alone the spine breathes."""
    silence = [np.zeros(CHUNK_SAMPLES * 4, np.float32)]
    bundle = load_bundle(tiny_bundle)
    shown = {how: animate(Pipeline(bundle.running(how)), silence, seed=3).motion for how in ("paper", "idle")}
    spine = HUMANOID.index("spine")
    assert np.abs(shown["paper"].rotations[:, spine] - shown["idle"].rotations[:, spine]).max() > 1e-4
    pipeline, one = Pipeline(bundle.running("paper")), torch.ones(1, dtype=torch.bool)
    state = pipeline.init_state(1)
    pipeline.reset(state, one, seed=3)
    bare = [pipeline.step(torch.zeros(1, CHUNK_SAMPLES), state, one)[0].rotations.copy() for _ in range(4)]
    np.testing.assert_array_equal(np.concatenate(bare), shown["paper"].rotations)


def test_bare_leaves_out_the_papers_cylinder_too(tiny_bundle) -> None:
    bare = Runtime().chosen("bare")
    assert (bare.label, bare.cylinder, bare.additions) == ("bare", False, ())
    assert Pipeline(load_bundle(tiny_bundle).running("bare")).cylinder is None


def test_under_the_papers_runtime_the_user_changes_nothing(tiny_bundle) -> None:
    """Silence is shown alike whether or not a user speaks; with `listening` the head turns to the user."""
    bundle, user = load_bundle(tiny_bundle), np.random.default_rng(0).normal(0, 0.2, 24_000).astype(np.float32)

    def shown(how: str, heard: np.ndarray | None) -> np.ndarray:
        session = Engine(Pipeline(bundle.running(how)), seats=1, workers=0).open(seed=3)
        if heard is not None:
            session.listen(heard)
        session.push(np.zeros(CHUNK_SAMPLES * 8, np.float32))
        session.finish()
        return np.concatenate([chunk.rotations for chunk in session])

    np.testing.assert_array_equal(shown("paper", None), shown("paper", user))
    assert np.abs(shown("listening", None) - shown("listening", user)).max() > 1e-3
