import math

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.interpolate import StreamInterpolator
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_multiply,
)
from echoavatar.motion.motion_chunk import MotionChunk


def waving(frames: int = 48, joints: int = 3) -> MotionChunk:
    """Turns of up to 1.2 rad at 1.5 Hz about different axes, a wandering root, a face."""
    time = np.arange(frames) / 30
    axes = np.random.default_rng(0).standard_normal((joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors = 1.2 * axes * np.sin(2 * math.pi * 1.5 * time)[:, None, None]
    turns = quaternion_from_axis_angle(vectors).astype(np.float32)
    turns = np.where(turns[..., :1] < 0, -turns, turns)
    root = np.stack([0.1 * np.sin(time), 0.9 + 0 * time, 0.1 * time], -1).astype(np.float32)
    face = np.tile(np.clip(0.5 + 0.6 * np.sin(5 * time), 0, 1)[:, None], (52, 1)).astype(np.float32)
    return MotionChunk(turns, root, face)


def part(chunk: MotionChunk, at: slice) -> MotionChunk:
    assert chunk.face is not None
    return MotionChunk(chunk.rotations[at], chunk.root[at], chunk.face[at])


def streamed(chunk: MotionChunk, sizes: list[int], fps: float) -> list[MotionChunk]:
    stream, out, start = StreamInterpolator(fps), [], 0
    for size in sizes:
        out.append(stream.push(part(chunk, slice(start, start + size))))
        start += size
    return [*out, stream.finish()]


def joined(chunks: list[MotionChunk]) -> MotionChunk:
    return MotionChunk(*(np.concatenate(values) for values in zip(*chunks, strict=True)))  # type: ignore[arg-type]


def speeds(rotations: np.ndarray, fps: float) -> np.ndarray:
    """Angular velocity vectors (t - 1, j, 3), rad/s, in the parent's axes."""
    q = rotations.astype(np.float64)
    steps = quaternion_multiply(q[1:], quaternion_conjugate(q[:-1]))
    return axis_angle_from_quaternion(steps) * fps


@pytest.mark.parametrize("fps", [60, 24, 72, 90, 59.94, 144])
@pytest.mark.parametrize("sizes", [[8] * 6, [1] * 48, [2, 3, 43]])
def test_any_chunking_gives_the_whole(fps: float, sizes: list[int]) -> None:
    chunk = waving()
    pieces, whole = joined(streamed(chunk, sizes, fps)), joined(streamed(chunk, [48], fps))
    for a, b in zip(pieces, whole, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_source_frames_are_met_and_delay_is_one_frame() -> None:
    chunk = waving()
    chunks = streamed(chunk, [8] * 6, 60)
    assert [len(c.root) for c in chunks] == [13, 16, 16, 16, 16, 16, 2]
    whole = joined(chunks)
    assert np.array_equal(whole.rotations[::2], chunk.rotations)
    assert np.array_equal(whole.root[::2], chunk.root)


def test_no_step_in_angular_velocity_at_frames_or_chunk_borders() -> None:
    """At 120 fps, four steps a frame: velocity changes as little across a frame as the true wave's does."""
    whole = joined(streamed(waving(), [8] * 6, 120))
    change = np.linalg.norm(np.diff(speeds(whole.rotations, 120), axis=0), axis=-1)[4:-4]
    true = 1.2 * (2 * math.pi * 1.5) ** 2 / 120  # greatest acceleration times the step
    assert change.max() < 1.35 * true
    slerped = resample(swaying_like(waving()), 120).rotations
    kinks = np.linalg.norm(np.diff(speeds(slerped, 120), axis=0), axis=-1)[4:-4]
    assert kinks.max() > 3 * true  # what plain slerp does


def swaying_like(chunk: MotionChunk):  # type: ignore[no-untyped-def]
    motion = swaying(48)
    rotations = np.tile(chunk.rotations[:, :1], (1, motion.skeleton.joints, 1))
    return type(motion)(motion.skeleton, rotations, chunk.root, 30.0)


def test_halfway_it_follows_the_wave() -> None:
    """Outside witness: the wave itself, evaluated between the frames."""
    time = np.arange(95) / 60
    whole = joined(streamed(waving(), [8] * 6, 60))
    vectors = axis_angle_from_quaternion(whole.rotations.astype(np.float64))
    angle = np.linalg.norm(vectors, axis=-1)
    np.testing.assert_allclose(angle[2:-2, 0], np.abs(1.2 * np.sin(2 * math.pi * 1.5 * time))[2:-2], atol=0.006)


def test_a_whole_motion_keeps_its_length() -> None:
    motion = swaying(31)
    for fps in (24, 60, 59.94, 120):
        stream = StreamInterpolator(fps)
        frames = sum(len(c.root) for c in (stream.push(MotionChunk(motion.rotations, motion.root)), stream.finish()))
        assert frames == resample(motion, fps).frames


def test_a_stream_without_face_stays_without() -> None:
    chunk = waving()
    bare = MotionChunk(chunk.rotations, chunk.root)
    assert StreamInterpolator(60).push(bare).face is None


def test_impossible_rates_and_empty_streams_are_explained() -> None:
    with pytest.raises(MotionError, match="choose 0.1 to 1000"):
        StreamInterpolator(0)
    with pytest.raises(MotionError, match="nothing was pushed"):
        StreamInterpolator(60).finish()
