"""What is sent to Unity, compared with the release's own numbers."""

import json

import numpy as np
import pytest
from tests import golden as fixtures

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.errors import CheckpointError
from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar_lab.reference.release_rig import AXES
from echoavatar_lab.unity.frames import (
    HEADER,
    Messages,
    UnityAxes,
    at_60_fps,
    face47,
    merge_channels,
    rotations_at_60_fps,
    smoothed,
    write_face47,
)

EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def rig(unity=()) -> RigConfig:
    return RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=unity)


def same_rotations(ours: np.ndarray, theirs: np.ndarray, atol: float = 1e-5) -> None:
    signs = np.where((ours * theirs).sum(-1, keepdims=True) < 0, -1, 1)
    np.testing.assert_allclose(ours * signs, theirs, atol=atol)


@pytest.fixture(scope="module")
def golden() -> dict[str, np.ndarray]:
    return dict(np.load(fixtures.golden("reference_release/stream_post.npz")))


def test_the_matrix_of_each_joint_found_on_half_the_frames_turns_the_other_half(golden) -> None:
    """U = M R M^-1 determines M (negative determinant) up to a factor; the user's stats folder contains M itself."""
    theirs = golden["quat_wxyz"].astype(np.float64)
    unity = golden["unity_quat_xyzw"][..., [3, 0, 1, 2]].astype(np.float64)
    rotations, wanted = (matrix_from_quaternion(q) for q in (theirs, unity))
    found = []
    for joint in range(88):
        pairs = zip(wanted[:12, joint], rotations[:12, joint], strict=True)
        rows = [np.kron(u, np.eye(3)) - np.kron(np.eye(3), r.T) for u, r in pairs]
        m = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 3)
        m /= np.cbrt(abs(np.linalg.det(m)))
        found.append(-m if np.linalg.det(m) > 0 else m)
    axes = np.array(AXES, np.float64)
    ours = quaternion_from_matrix(axes @ rotations[12:] @ axes.T).astype(np.float32)
    sent = UnityAxes(rig(tuple(tuple(map(tuple, m)) for m in found))).rotations(ours)
    same_rotations(sent, golden["unity_quat_xyzw"][12:], 5e-4)
    np.testing.assert_allclose([np.linalg.det(m) for m in found], -1, atol=1e-6)


def test_positions(golden) -> None:
    metres = golden["trans"] @ np.array(AXES).T * 0.01
    sent = UnityAxes(rig((EYE,) * 88)).positions(metres)
    np.testing.assert_allclose(sent, golden["unity_trans"], atol=2e-5)


def test_sixty_frames_a_second(golden) -> None:
    rotations, trans = golden["unity_quat_xyzw"], golden["unity_trans"]
    for name, part in (("a", slice(0, 12)), ("b", slice(12, 24))):
        same_rotations(rotations_at_60_fps(rotations[part]), golden[f"body60_{name}"])
        np.testing.assert_allclose(at_60_fps(trans[part]), golden[f"body60_{name}_trans"], atol=1e-5)


def test_the_face(golden) -> None:
    np.testing.assert_array_equal(merge_channels(golden["bs52"]), golden["bs47"])
    first = smoothed(golden["bs47"][:12], None)
    np.testing.assert_allclose(at_60_fps(first), golden["face60_a"], atol=1e-5)
    second = smoothed(golden["bs47"][12:], first[-1])
    np.testing.assert_allclose(at_60_fps(second), golden["face60_b"], atol=1e-5)


def test_our_order_of_channels_goes_to_the_same_places() -> None:
    curves = np.zeros((1, 52), np.float32)
    curves[0, ARKIT_NAMES.index("jawRight")] = 0.5
    sent = face47(curves)[0]
    plain = np.zeros((1, 52), np.float32)
    plain[0, APPLE_NAMES.index("jawRight")] = 0.5
    assert np.array_equal(sent, merge_channels(plain)[0])
    assert sent.sum() == 0.5
    assert sent.shape == (47,)


def test_a_table_of_the_47_channels(tmp_path) -> None:
    curves = np.zeros((3, 52), np.float32)
    curves[2, ARKIT_NAMES.index("mouthUpperUpRight")] = 0.25
    write_face47(tmp_path / "a.face47.csv", curves, 30.0)
    head, *rows = (tmp_path / "a.face47.csv").read_text().splitlines()
    names = head.split(",")
    assert len(names) == len(set(names)) == 48
    assert float(rows[2].split(",")[names.index("mouthUpperUp")]) == 0.25
    assert float(rows[2].split(",")[0]) == pytest.approx(2 / 30, abs=1e-6)


def test_a_bundle_without_transforms_is_refused() -> None:
    with pytest.raises(CheckpointError, match="no transforms for Unity"):
        UnityAxes(rig())


def chunks(count: int) -> list[tuple[MotionChunk, np.ndarray]]:
    """Chunks of eight frames; the root moves one centimetre per frame, and the sound counts its samples."""
    made = []
    for index in range(count):
        turns = np.tile(np.float32([1, 0, 0, 0]), (8, 88, 1))
        root = np.zeros((8, 3), np.float32)
        root[:, 0] = 0.01 * (np.arange(8) + 8 * index)
        sound = np.arange(6400, dtype=np.float32) + 6400 * index
        made.append((MotionChunk(turns, root, np.zeros((8, 52), np.float32)), sound))
    return made


def test_three_chunks_are_two_messages() -> None:
    messages = Messages(RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=(EYE,) * 88))
    sent = [list(messages.push(*chunk)) for chunk in chunks(6)]
    assert [len(own) for own in sent] == [0, 1, 1, 0, 1, 1]
    bodies = []
    for message in (m for own in sent for m in own):
        (size,) = HEADER.unpack(message[:4])
        assert size == len(message) - 4
        bodies.append(json.loads(message[4:]))
    shapes = {name: np.shape(bodies[0][name]) for name in bodies[0]}
    assert shapes == {"pose": (24, 88, 4), "trans": (24, 3), "blendshape": (24, 47), "audio": (9600,)}
    audio = np.concatenate([body["audio"] for body in bodies])
    assert np.array_equal(audio, np.arange(4 * 9600))
    steps = np.concatenate([np.array(body["trans"])[::2, 0] for body in bodies])
    np.testing.assert_allclose(steps, np.arange(48), atol=1e-4)
    assert np.array(bodies[0]["pose"])[0, 0].tolist() == [0, 0, 0, 1]


def test_a_bundle_without_a_face_sends_a_face_at_rest() -> None:
    messages = Messages(RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=(EYE,) * 88))
    (motion, audio), (more, sound) = chunks(2)
    list(messages.push(motion._replace(face=None), audio))
    (message,) = messages.push(more._replace(face=None), sound)
    assert not np.any(json.loads(message[4:])["blendshape"])
