"""Poses and sound as bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from echoavatar.wire.blobs import Pose, pack_audio, pack_pose, unpack_audio, unpack_pose
from echoavatar.wire.codec import ProtocolError, encode
from echoavatar.wire.messages import AudioFormat


def random_pose(seed: int, frames: int = 8) -> Pose:
    draw = np.random.default_rng(seed)
    turns = draw.normal(size=(frames, 52, 4)).astype(np.float32)
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    return Pose(turns, draw.normal(size=(frames, 3)).astype(np.float32), draw.random((frames, 52), np.float32))


@given(seed=st.integers(0, 1000))
def test_a_pose_survives_within_half_a_step(seed: int) -> None:
    """A component is off by at most 1/65534, so a rotation by at most 2 * sqrt(4) / 65534 rad = 0.0035 degrees."""
    pose = random_pose(seed, frames=2)
    back = unpack_pose(pack_pose(pose, at=0))
    chord = [np.linalg.norm(back.rotations - sign * pose.rotations, axis=-1) for sign in (1, -1)]
    assert np.degrees(2 * np.minimum(*chord)).max() < 0.004
    np.testing.assert_array_equal(back.root, pose.root)
    assert back.face is not None
    np.testing.assert_allclose(back.face, pose.face, atol=0.5 / 255 + 1e-6)


def test_a_chunk_with_a_face_is_under_seven_kilobytes() -> None:
    assert len(encode(pack_pose(random_pose(0), at=2**40, epoch=9, state="listening"))) < 4_100


def test_the_same_rotation_is_the_same_bytes() -> None:
    pose = random_pose(1)
    assert pack_pose(pose, at=0) == pack_pose(pose._replace(rotations=-pose.rotations), at=0)


def test_the_wire_order_is_xyzw() -> None:
    turn = np.zeros((1, 52, 4), np.float32)
    turn[..., 0] = 1
    motion = pack_pose(Pose(turn, np.zeros((1, 3), np.float32), None), at=0)
    assert np.frombuffer(motion.rotations, "<i2")[:4].tolist() == [0, 0, 0, 32_767]
    assert unpack_pose(motion).face is None


@pytest.mark.parametrize("frames", [0, -1, 7, 9, 2**40])
def test_bytes_that_do_not_fit_are_refused(frames: int) -> None:
    import msgspec

    motion = msgspec.structs.replace(pack_pose(random_pose(0), at=0), frames=frames)
    with pytest.raises(ProtocolError):
        unpack_pose(motion)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_place_that_is_not_a_number_is_refused(value: float) -> None:
    pose = random_pose(0)
    pose.root[-1, 2] = value
    with pytest.raises(ProtocolError, match="finite"):
        unpack_pose(pack_pose(pose, at=0))


def test_sound_survives_within_half_a_step() -> None:
    sound = np.linspace(-1, 1, 1001, dtype=np.float32)
    back = unpack_audio(pack_audio(sound), AudioFormat())
    np.testing.assert_allclose(back, sound, atol=1 / 16_384)


def test_two_channels_become_one() -> None:
    pcm = np.array([0.5, -0.5, 0.25, 0.75], "<f4").tobytes()
    assert unpack_audio(pcm, AudioFormat(channels=2, format="f32le")).tolist() == [0, 0.5]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_sound_that_is_not_a_number_is_refused(value: float) -> None:
    with pytest.raises(ProtocolError, match="finite") as caught:
        unpack_audio(np.array([0, value], "<f4").tobytes(), AudioFormat(format="f32le"))
    assert not caught.value.fatal


def test_half_a_sample_is_refused() -> None:
    with pytest.raises(ProtocolError, match="whole number"):
        unpack_audio(b"\0\0\0", AudioFormat())
