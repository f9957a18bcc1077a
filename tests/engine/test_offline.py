from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.models.face.tiny import make

from echoavatar.engine import animate, animate_many, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError


@pytest.fixture(scope="module")
def pipeline(tiny_bundle: Path) -> Pipeline:
    return Pipeline(load_bundle(tiny_bundle), precision="float32")


@pytest.mark.parametrize(("samples", "frames"), [(1, 1), (800, 1), (801, 2), (48_000, 60), (10_000, 13)])
def test_motion_is_as_long_as_the_sound_rounded_up_to_a_frame(
    pipeline: Pipeline, voice: np.ndarray, samples: int, frames: int
) -> None:
    done = animate(pipeline, [voice[:samples]])
    assert done.motion.frames == frames
    assert len(done.audio) == frames * 800


def test_cutting_the_sound_does_not_change_the_motion(pipeline: Pipeline, voice: np.ndarray) -> None:
    whole = animate(pipeline, [voice], seed=2).motion
    for blocks in (in_blocks(voice, 0.05), [voice[:7], voice[7:30_000], voice[30_000:]]):
        pieces = animate(pipeline, blocks, seed=2).motion
        np.testing.assert_allclose(pieces.rotations, whole.rotations, atol=1e-5)
        np.testing.assert_allclose(pieces.root, whole.root, atol=1e-5)


def test_no_sound_is_an_error_that_says_so(pipeline: Pipeline) -> None:
    with pytest.raises(AudioError, match="no sound"):
        animate(pipeline, [])


def test_progress_counts_seconds(pipeline: Pipeline, voice: np.ndarray) -> None:
    told: list[float] = []
    animate(pipeline, in_blocks(voice), progress=told.append)
    assert told[0] == pytest.approx(8 / 30)
    assert told == sorted(told)


def test_many_at_once_are_as_one_by_one(tiny_bundle: Path, voice: np.ndarray) -> None:
    """Sounds of different lengths end at different ticks; the others go on. Their faces come with them."""
    bundle = replace(load_bundle(tiny_bundle), face=make().float())
    pipeline = Pipeline(bundle, precision="float32")
    sounds = [voice, voice[:9_000] * 0.3, voice[5_000:]]
    told: list[tuple[int, int]] = []
    shown = animate_many(pipeline, sounds, seeds=[4, 5, 6], progress=lambda *at: told.append(at))
    assert told[-1] == (8 + 2 + 7, 8 + 2 + 7)
    for (motion, audio, seconds, face), sound, seed in zip(shown, sounds, [4, 5, 6], strict=True):
        alone = animate(pipeline, [sound], seed=seed)
        np.testing.assert_allclose(motion.rotations, alone.motion.rotations, atol=1e-5)
        np.testing.assert_allclose(motion.root, alone.motion.root, atol=1e-5)
        np.testing.assert_array_equal(audio, alone.audio)
        assert seconds > 0
        assert face is not None
        assert alone.face is not None
        assert face.shape == (motion.frames, 52)
        np.testing.assert_allclose(face, alone.face, atol=1e-4)


def test_a_sound_without_samples_among_many_is_named(pipeline: Pipeline, voice: np.ndarray) -> None:
    with pytest.raises(AudioError, match="number 1"):
        animate_many(pipeline, [voice, voice[:0]], seeds=[0, 1])
