from pathlib import Path

import numpy as np
import pytest

from echoavatar.engine import animate, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError, MotionError


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


@pytest.mark.parametrize("fps", [0, -30, 0.001, 1001, float("nan")])
def test_a_wrong_frame_rate_is_refused_before_any_sound_is_read(pipeline: Pipeline, fps: float) -> None:
    unread = iter([np.zeros(800, np.float32)])
    with pytest.raises(MotionError, match="frames per second"):
        animate(pipeline, unread, fps=fps)
    assert len(list(unread)) == 1


def test_progress_counts_seconds(pipeline: Pipeline, voice: np.ndarray) -> None:
    told: list[float] = []
    animate(pipeline, in_blocks(voice), progress=told.append)
    assert told[0] == pytest.approx(8 / 30)
    assert told == sorted(told)
