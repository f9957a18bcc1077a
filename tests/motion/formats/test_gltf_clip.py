"""Animations of a GLB as motion: keys between frames, names, and files without any."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import NAMES, offsets_of
from tests.files.exports.odd import Odd, glb

from echoavatar.errors import MotionError
from echoavatar.files.avatar.gltf import Buffer, container
from echoavatar.files.exports import read_take
from echoavatar.motion.formats.gltf_clip import read_gltf_clip
from echoavatar.motion.formats.gltf_data import read_chunks
from echoavatar.motion.kinematics.rotations import angle_between

BODY = offsets_of(body=0.9, legs=1.1, arms=1.2)


def animated(path: Path, change: Callable[[Buffer], dict], *, name: str = "one") -> Path:  # type: ignore[type-arg]
    """A plain rig whose left upper arm has one track."""
    data = glb(Odd(BODY))
    path.write_bytes(data)
    file, buffer = read_chunks(path), Buffer()
    document = file.document
    buffer.data, buffer.views, buffer.accessors = bytearray(file.data), document["bufferViews"], document["accessors"]
    sampler = change(buffer)
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    hips, arm = (
        {"sampler": 0, "target": {"node": NAMES.index(bone), "path": "rotation"}} for bone in ("hips", "leftUpperArm")
    )
    document["animations"] = [
        {"name": "still", "samplers": [sampler], "channels": [hips]},
        {"name": name, "samplers": [sampler], "channels": [arm, hips]},
    ]
    path.write_bytes(container(document, bytes(buffer.data)))
    return path


def turn(angle: float) -> list[float]:
    return [0, 0, float(np.sin(angle / 2)), float(np.cos(angle / 2))]


@pytest.mark.parametrize("kind", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_keys_between_frames_are_interpolated(kind: str, tmp_path: Path) -> None:
    """A quarter turn in half a second, by keys that come ten times a second and then once."""

    def keys(buffer: Buffer) -> dict:  # type: ignore[type-arg]
        times = np.array([0, 0.1, 0.2, 0.3, 0.5], np.float32)
        turns = np.array([turn(np.pi * t) for t in times], np.float32)
        if kind == "CUBICSPLINE":
            slopes = np.pi / 2 * np.array([[0, 0, q[3], -q[2]] for q in turns], np.float32)
            turns = np.stack([slopes, turns, slopes], 1).reshape(-1, 4)
        return {"input": buffer.add(times, bounds=True), "output": buffer.add(turns), "interpolation": kind}

    motion = read_gltf_clip(animated(tmp_path / "a.glb", keys), "one")
    assert motion.fps == 10
    assert motion.frames == 6
    wanted = np.pi * np.array([0, 0.1, 0.2, 0.3, 0.3 if kind == "STEP" else 0.4, 0.5])
    arm = motion.matrices()[:, motion.skeleton.config.vrm["leftUpperArm"]]
    cosines, sines = np.cos(wanted), np.sin(wanted)
    for frame, cosine, sine in zip(arm, cosines, sines, strict=True):
        matrix = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]], np.float32)
        assert angle_between(frame, matrix) < 2e-3


@pytest.mark.parametrize("rate", [30000 / 1001, 24000 / 1001, 30.0, 60.0])
def test_the_rate_of_the_keys_is_kept_over_ten_minutes(rate: float, tmp_path: Path) -> None:
    frames = round(600 * rate)

    def keys(buffer: Buffer) -> dict:  # type: ignore[type-arg]
        times = (np.arange(frames) / rate).astype(np.float32)
        turns = np.array([turn(0.001 * k) for k in range(frames)], np.float32)
        return {"input": buffer.add(times, bounds=True), "output": buffer.add(turns)}

    motion = read_gltf_clip(animated(tmp_path / "a.glb", keys), "one")
    assert motion.fps == pytest.approx(rate, rel=1e-9)
    assert motion.frames == frames


@pytest.mark.parametrize(
    ("times", "fps"), [((0, 0.5, 1), 30), ((0, 0.1, 0.15, 0.5, 0.55, 1), 20), ((0, 0.1, 0.3, 0.4, 1), 10)]
)
def test_sparse_keys_are_sampled_so_that_none_is_lost(times: tuple[float, ...], fps: float, tmp_path: Path) -> None:
    """Keys of an animator, and those that a program which drops needless keys leaves."""
    motion = read_gltf_clip(animated(tmp_path / "a.glb", turning(list(times))), "one")
    assert (motion.fps, motion.frames) == (fps, fps + 1)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_each_stepped_key_is_shown_from_its_own_frame_on(unit: float, tmp_path: Path) -> None:
    """In seconds or milliseconds, whose 32 bits say a minute with an error of two millionths of a second."""
    angles = 0.1 * (np.arange(1_800) % 7)

    def keys(buffer: Buffer) -> dict:  # type: ignore[type-arg]
        times = (unit * np.arange(len(angles)) / 30).astype(np.float32)
        turns = np.array([turn(angle) for angle in angles], np.float32)
        return {"input": buffer.add(times, bounds=True), "output": buffer.add(turns), "interpolation": "STEP"}

    motion = read_gltf_clip(animated(tmp_path / "a.glb", keys), "one")
    arm = motion.matrices()[:, motion.skeleton.config.vrm["leftUpperArm"]]
    np.testing.assert_allclose(np.arctan2(arm[:, 1, 0], arm[:, 0, 0]), angles, atol=1e-3)


def test_an_animation_is_chosen_by_its_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def keys(buffer: Buffer) -> dict:  # type: ignore[type-arg]
        times, turns = np.array([0, 0.1], np.float32), np.array([turn(0), turn(1)], np.float32)
        return {"input": buffer.add(times), "output": buffer.add(turns)}

    path = animated(tmp_path / "a.glb", keys)
    with caplog.at_level(logging.WARNING):
        assert read_take(path).motion.frames == 2
    assert "has 2 animations (still, one)" in caplog.text
    with pytest.raises(MotionError, match="no animation named 'run'; it has still, one"):
        read_take(path, animation="run")
    (tmp_path / "none.glb").write_bytes(glb(Odd(BODY)))
    with pytest.raises(MotionError, match="has no animation; choose another"):
        read_take(tmp_path / "none.glb")


def turning(times: list[float]) -> Callable[[Buffer], dict]:  # type: ignore[type-arg]
    def keys(buffer: Buffer) -> dict:  # type: ignore[type-arg]
        turns = np.array([turn(t) for t in times], np.float32)
        return {"input": buffer.add(np.array(times, np.float32)), "output": buffer.add(turns)}

    return keys


def changed(path: Path, change: Callable[[list], None]) -> Path:  # type: ignore[type-arg]
    """The file with other animations."""
    file = read_chunks(animated(path, turning([0, 0.1, 0.2])))
    change(file.document["animations"])
    path.write_bytes(container(file.document, bytes(file.data)))
    return path


def test_of_several_the_first_that_moves_the_body_is_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def put_first(animations: list) -> None:  # type: ignore[type-arg]
        pointer = {"sampler": 0, "target": {"path": "pointer"}}
        animations.insert(0, {"name": "lights", "samplers": animations[0]["samplers"], "channels": [pointer]})

    assert read_take(changed(tmp_path / "a.glb", put_first)).motion.frames == 3
    assert "(lights, still, one); 'still' is read" in caplog.text


def test_a_pose_before_the_animation_is_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = changed(tmp_path / "a.glb", lambda animations: None)
    file, buffer = read_chunks(data), Buffer()
    document = file.document
    buffer.data, buffer.views, buffer.accessors = bytearray(file.data), document["bufferViews"], document["accessors"]
    keys = {
        "input": buffer.add(np.array([0, 1], np.float32)),
        "output": buffer.add(np.array([turn(1)] * 2, np.float32)),
    }
    spline = keys | {"output": buffer.add(np.array([[0] * 4, turn(1), [0] * 4] * 2, np.float32))}
    for sampler in (keys, spline | {"interpolation": "CUBICSPLINE"}):
        document["animations"].insert(0, document["animations"][0] | {"name": "T-pose", "samplers": [sampler]})
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    data.write_bytes(container(document, bytes(buffer.data)))
    assert read_take(data).motion.frames == 3
    assert "(T-pose, T-pose_2, still, one); 'still' is read" in caplog.text


def test_an_animation_for_each_node_is_one(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """So write COLLADA2GLTF, and Blender for a body whose parent moves too."""
    whole = read_take(changed(tmp_path / "a.glb", lambda animations: None), animation="one").motion
    apart = changed(tmp_path / "b.glb", lambda animations: animations[1].update(channels=animations[1]["channels"][:1]))
    np.testing.assert_array_equal(read_take(apart).motion.rotations, whole.rotations)
    assert "(still, one); 2 are read as one" in caplog.text
    assert read_take(apart, animation="one").motion.rotations[-1, 0] == pytest.approx(whole.rotations[0, 0], abs=1e-6)


def test_animations_of_one_name_are_numbered(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = changed(tmp_path / "a.glb", lambda animations: [one.update(name="Take 001") for one in animations] and None)
    read_take(path)
    assert "(Take 001, Take 001_2)" in caplog.text
    arm = read_take(path, animation="Take 001_2").motion
    assert not np.allclose(arm.rotations[-1], arm.rotations[0])


def test_a_face_that_is_left_out_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    face = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    read_take(changed(tmp_path / "a.glb", lambda animations: animations[0]["channels"].append(face)))
    assert "its face is left out" in caplog.text
    caplog.clear()
    read_take(changed(tmp_path / "b.glb", lambda animations: None))
    assert "its face" not in caplog.text


def test_two_keys_at_one_time_are_a_jump(tmp_path: Path) -> None:
    motion = read_gltf_clip(animated(tmp_path / "a.glb", turning([0, 0.1, 0.1, 0.2])), "one")
    assert motion.frames == 3


@pytest.mark.parametrize(("step", "said"), [(1.0, "1 s apart"), (33.333, "33.3 s apart"), (0.5, "")])
def test_keys_that_may_be_counted_in_frames_or_milliseconds_are_told(
    step: float, said: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_gltf_clip(animated(tmp_path / "a.glb", turning([0, step, 2 * step])), "one")
    assert said in caplog.text
    assert bool(said) == bool(caplog.text)


@pytest.mark.parametrize("rate", [30.0, 30000 / 1001, 60.0])
def test_keys_in_milliseconds_are_taken_for_these(
    rate: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def keys(unit: float) -> Callable[[Buffer], dict]:  # type: ignore[type-arg]
        times = np.arange(20) / rate

        def add(buffer: Buffer) -> dict:  # type: ignore[type-arg]
            turns = np.array([turn(time) for time in times], np.float32)
            return {"input": buffer.add((unit * times).astype(np.float32)), "output": buffer.add(turns)}

        return add

    plain = read_gltf_clip(animated(tmp_path / "a.glb", keys(1.0)), "one")
    assert not caplog.text
    motion = read_gltf_clip(animated(tmp_path / "b.glb", keys(1000.0)), "one")
    assert (motion.fps, motion.frames) == (plain.fps, plain.frames) == (pytest.approx(rate), 20)
    np.testing.assert_allclose(motion.rotations, plain.rotations, atol=1e-5)
    assert "the times of its keys are taken for milliseconds" in caplog.text


def test_keys_that_go_back_in_time_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="go back in time"):
        read_gltf_clip(animated(tmp_path / "a.glb", turning([0.2, 0.1, 0])), "one")
