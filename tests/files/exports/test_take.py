from pathlib import Path

import numpy as np
import pytest

from echoavatar.agents.client import Recording
from echoavatar.errors import MotionError
from echoavatar.files.exports import Take, read_take
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion


def recording(take: Take, names: tuple[str, ...] = HUMANOID.names) -> Recording:
    motion = take.motion
    assert take.face is not None
    order = list(reversed(range(52)))
    return Recording(
        names=names,
        face_names=tuple(ARKIT_NAMES[k] for k in order),
        rotations=motion.rotations,
        root=motion.root,
        face=take.face[:, order],
        audio=np.zeros(motion.frames * 800, np.float32),
    )


def test_what_a_client_recorded_is_read_by_names(short: Take, tmp_path: Path) -> None:
    recording(short).save(tmp_path / "a.npz")
    read = read_take(tmp_path / "a.npz")
    np.testing.assert_allclose(read.motion.rotations, short.motion.rotations)
    np.testing.assert_allclose(read.face, short.face)
    assert read.motion.fps == 30
    assert read.audio is not None
    assert len(read.audio) == 45 * 800


def test_what_animate_wrote_is_read(short: Take, tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", short.motion, face=short.face, face_names=np.array(ARKIT_NAMES))
    read = read_take(tmp_path / "a.npz")
    np.testing.assert_array_equal(read.motion.root, short.motion.root)
    np.testing.assert_array_equal(read.face, short.face)
    write_npz(tmp_path / "b.npz", short.motion)
    assert read_take(tmp_path / "b.npz").face is None


def test_a_bvh_is_motion_without_a_face_and_may_have_another_rig(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    motion = short.motion
    write_bvh(tmp_path / "a.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    read = read_take(tmp_path / "a.bvh")
    assert read.face is None
    assert read.on_humanoid() is read
    other = read_take(rigs["tall"])
    assert other.on_humanoid().motion.skeleton is HUMANOID


@pytest.mark.parametrize("rate", [24000 / 1001, 30000 / 1001, 60.0, 25.0, 120.0])
def test_at_another_rate_every_frame_shows_its_time(rate: float) -> None:
    times = np.arange(round(10 * rate)) / rate
    root = np.stack([times, times * 0, times * 0], 1).astype(np.float32)
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (len(times), HUMANOID.joints, 1))
    take = Take(Motion(HUMANOID, still, root, rate), np.tile(times[:, None] / 10, (1, 52)).astype(np.float32))
    ours = take.at(30.0)
    assert ours.face is not None
    np.testing.assert_allclose(ours.motion.root[:, 0], np.arange(ours.motion.frames) / 30, atol=1e-4)
    np.testing.assert_allclose(ours.face[:, 0], np.arange(ours.motion.frames) / 300, atol=1e-5)
    assert ours.motion.seconds == pytest.approx(10, abs=0.05)


@pytest.mark.parametrize("kind", ["missing", "text", "other rig", "other length", "wav"])
def test_what_cannot_be_used_is_named(kind: str, short: Take, tmp_path: Path) -> None:
    path = tmp_path / ("a.wav" if kind == "wav" else "a.npz")
    if kind == "text":
        path.write_text("no zip")
    elif kind == "other rig":
        recording(short, tuple(f"bone{k}" for k in range(52))).save(path)
    elif kind == "other length":
        assert short.face is not None
        write_npz(path, short.motion, face=short.face[:7], face_names=np.array(ARKIT_NAMES))
    with pytest.raises(MotionError):
        read_take(path)


@pytest.mark.parametrize("suffix", [".npz", ".bvh"])
def test_an_animation_is_refused_where_a_file_has_no_names(suffix: str, short: Take, tmp_path: Path) -> None:
    path, motion = tmp_path / f"a{suffix}", short.motion
    if suffix == ".npz":
        write_npz(path, motion)
    else:
        write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps)
    with pytest.raises(MotionError, match=rf"a\{suffix} holds one motion without a name: .* 'walk'"):
        read_take(path, animation="walk")


def test_a_map_is_refused_for_a_recording_and_does_not_hide_what_a_file_is(short: Take, tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", short.motion)
    with pytest.raises(MotionError, match=r"a\.npz has known bones: a map is for a BVH"):
        read_take(tmp_path / "a.npz", {"hips": "Hips"})
    (tmp_path / "a.fbx").write_bytes(b"Kaydara FBX Binary")
    with pytest.raises(MotionError, match=r"a\.fbx is neither .npz nor .bvh nor .glb"):
        read_take(tmp_path / "a.fbx", {"hips": "Hips"})
