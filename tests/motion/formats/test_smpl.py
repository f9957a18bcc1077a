"""Every layout of SMPL motion gives the motion that SMPL-X gives; what a layout lacks rests."""

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.cli import main
from echoavatar.errors import MotionError
from echoavatar.files.exports import read_take
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.motion.kinematics.rotations import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    quaternion_multiply,
)

FRAMES = 12
SWAY = swaying(FRAMES, size=0.2, skeleton=skeleton())
BODY, HANDS = slice(0, 22), slice(25, 55)


def arrays(*, is_z_up: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Axis angles (t, 55, 3), and places of the pelvis."""
    rotations, trans = SWAY.rotations.astype(np.float64), SWAY.root.astype(np.float64)
    if is_z_up:
        quarter = np.broadcast_to(np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0], np.float64), (FRAMES, 4))
        rotations[:, 0] = quaternion_multiply(quarter, rotations[:, 0])
        trans = trans[:, [0, 2, 1]] * [1, -1, 1]
    return axis_angle_from_quaternion(rotations), trans


def matrices(poses: np.ndarray) -> np.ndarray:
    turns: np.ndarray = matrix_from_axis_angle(poses)
    return turns


POSES, TRANS = arrays()
PARTS = {"global_orient": POSES[:, 0], "body_pose": POSES[:, 1:22].reshape(FRAMES, -1), "transl": TRANS}
LEFT, RIGHT = POSES[:, 25:40].reshape(FRAMES, -1), POSES[:, 40:].reshape(FRAMES, -1)
UP_POSES, UP_TRANS = arrays(is_z_up=True)
SMPLH = np.concatenate([POSES[:, BODY], POSES[:, HANDS]], 1)
LAYOUTS = {  # arrays, and whether they have hands
    "SMPL-X": ({"poses": POSES.reshape(FRAMES, -1), "trans": TRANS}, True),
    "SMPL-X by joints": ({"poses": POSES, "trans": TRANS}, True),
    "SMPL-H": ({"poses": SMPLH.reshape(FRAMES, -1), "trans": TRANS}, True),
    "SMPL-H by joints": ({"poses": SMPLH, "trans": TRANS}, True),
    "SMPL": ({"poses": np.concatenate([POSES[:, BODY], POSES[:, :2]], 1).reshape(FRAMES, -1), "trans": TRANS}, False),
    "scaled, as in AIST++": ({"smpl_poses": POSES[:, :24], "smpl_trans": 93.7 * TRANS, "smpl_scaling": [93.7]}, False),
    "by another name": ({"full_pose": POSES, "transl": TRANS}, True),
    "the body alone": ({"poses": POSES[:, BODY], "transl": TRANS}, False),
    "Z up": ({"poses": UP_POSES.reshape(FRAMES, -1), "trans": UP_TRANS}, True),
    "parts": (PARTS, False),
    "parts with hands": (PARTS | {"left_hand_pose": LEFT, "right_hand_pose": RIGHT}, True),
    "parts with weights of hands": (PARTS | {"left_hand_pose": LEFT[:, :12], "right_hand_pose": RIGHT[:, :12]}, False),
    "parts of SMPL": (PARTS | {"body_pose": POSES[:, 1:24]}, False),
    "parts of AMASS": (
        {
            "root_orient": POSES[:, 0],
            "pose_body": POSES[:, 1:22].reshape(FRAMES, -1),
            "pose_hand": np.concatenate([LEFT, RIGHT], 1),
            "trans": TRANS,
        },
        True,
    ),
    "parts as matrices": (
        {
            "global_orient": matrices(POSES[:, 0]),
            "body_pose": matrices(POSES[:, 1:24]),
            "left_hand_pose": matrices(POSES[:, 25:40]),
            "right_hand_pose": matrices(POSES[:, 40:]),
            "transl": TRANS,
        },
        True,
    ),
    "the body as flat matrices": ({"poses": matrices(POSES[:, BODY]).reshape(FRAMES, -1), "trans": TRANS}, False),
    "parts as flat matrices": (PARTS | {"body_pose": matrices(POSES[:, 1:22]).reshape(FRAMES, -1)}, False),
    "one of a batch": ({"poses": POSES.reshape(1, FRAMES, -1), "trans": TRANS[None]}, True),
    "parts with an axis for the joint": (PARTS | {"global_orient": POSES[:, :1], "transl": TRANS[:, None]}, False),
    "parts with one jaw for all": (PARTS | {"jaw_pose": np.zeros(3)}, False),
    "degrees": ({"poses": np.degrees(POSES).reshape(FRAMES, -1), "trans": TRANS}, True),
    "parts, Z up": ({"global_orient": UP_POSES[:, 0], "body_pose": UP_POSES[:, 1:22], "transl": UP_TRANS}, False),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_gives_the_same_motion(name, tmp_path) -> None:  # type: ignore[no-untyped-def]
    stored, has_hands = LAYOUTS[name]
    np.savez(tmp_path / "a.npz", mocap_framerate=30.0, gender="neutral", **stored)  # type: ignore[arg-type]
    motion = read_take(tmp_path / "a.npz").motion
    assert (motion.frames, motion.fps) == (FRAMES, 30)
    turns, wanted = motion.matrices(), SWAY.matrices()
    np.testing.assert_allclose(turns[:, BODY], wanted[:, BODY], atol=1e-5, rtol=0)
    rest = np.broadcast_to(np.eye(3, dtype=np.float32), (FRAMES, 30, 3, 3))
    np.testing.assert_allclose(turns[:, HANDS], wanted[:, HANDS] if has_hands else rest, atol=1e-5, rtol=0)
    np.testing.assert_allclose(np.diff(motion.root, axis=0), np.diff(SWAY.root, axis=0), atol=1e-5)


@pytest.mark.parametrize("key", ["mocap_frame_rate", "mocap_framerate", "fps", "FPS", "mocap_fps", "video_frame_rate"])
@pytest.mark.parametrize("rate", [120.0, 59.94, 30000 / 1001])
def test_the_rate_is_taken_under_each_of_its_names(key, rate, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", **{key: np.array([rate])}, **LAYOUTS["SMPL-H"][0])
    assert read_take(tmp_path / "a.npz").motion.fps == rate
    assert not caplog.text


@pytest.mark.parametrize("rate", [np.full(FRAMES, 60.0), "60", np.array([[60]])])
def test_the_rate_may_have_any_form(rate, tmp_path) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", fps=rate, **LAYOUTS["SMPL-H"][0])
    assert read_take(tmp_path / "a.npz").motion.fps == 60


def test_a_single_frame_needs_no_axis_of_time(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", fps=30, **{name: array[0] for name, array in PARTS.items()})
    motion = read_take(tmp_path / "a.npz").motion
    assert motion.frames == 1
    np.testing.assert_allclose(motion.matrices()[:, BODY], SWAY.matrices()[:1, BODY], atol=1e-5, rtol=0)
    assert not caplog.text


def test_hands_that_are_left_out_are_named(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", fps=30, **LAYOUTS["parts with weights of hands"][0])
    read_take(tmp_path / "a.npz")
    assert "its left_hand_pose (12, 12) is left out" in caplog.text


def test_what_is_assumed_is_said(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", **LAYOUTS["Z up"][0])
    read_take(tmp_path / "a.npz")
    assert "its motion is turned to Y up" in caplog.text
    assert "30 frames per second are assumed" in caplog.text


def test_a_body_in_the_axes_of_a_camera_faces_it(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Y down, Z away from the camera, as those write who find bodies in films."""
    half = np.broadcast_to(np.array([0.0, 1.0, 0.0, 0.0]), (FRAMES, 4))
    rotations = SWAY.rotations.astype(np.float64)
    rotations[:, 0] = quaternion_multiply(half, rotations[:, 0])
    np.savez(tmp_path / "a.npz", poses=axis_angle_from_quaternion(rotations), trans=TRANS * [1, -1, -1], fps=30)
    motion = read_take(tmp_path / "a.npz").motion
    np.testing.assert_allclose(motion.matrices()[:, BODY], SWAY.matrices()[:, BODY], atol=1e-5, rtol=0)


def test_without_places_the_body_stays_where_it_is(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", poses=POSES, fps=30)
    motion = read_take(tmp_path / "a.npz").motion
    assert not np.ptp(motion.root, axis=0).any()
    assert "no 'trans', so the body stays in one place" in caplog.text


def test_it_is_exported(tmp_path) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", mocap_framerate=29.97, **LAYOUTS["parts, Z up"][0])
    assert main(["export", str(tmp_path / "a.npz"), "-o", str(tmp_path / "b.bvh")]) == 0
    motion = read_bvh(tmp_path / "b.bvh")
    assert motion.fps == 30000 / 1001
    assert motion.pose().positions[:, motion.skeleton.index("head"), 1].min() > 1.4


@pytest.mark.parametrize(
    ("stored", "complaint"),
    [
        ({"poses": np.zeros((4, 71)), "trans": np.zeros((4, 3))}, r"poses \(4, 71\)"),
        ({"poses": np.zeros((4, 75)), "trans": np.zeros((4, 3))}, r"poses \(4, 75\)"),
        ({"poses": np.zeros(164), "trans": np.zeros((1, 3))}, r"poses \(164,\)"),
        ({"poses": np.zeros((2, 4, 165)), "trans": np.zeros((4, 3))}, r"poses \(2, 4, 165\)"),
        ({"body_pose": np.zeros((4, 126)), "transl": np.zeros((4, 3))}, r"body_pose \(4, 126\)"),
        ({"joints": np.zeros((4, 22, 3))}, "has joints; give `poses`"),
        ({"poses": np.array([None, 1])}, "objects of Python; save plain arrays"),
        ({"poses": POSES, "trans": 300 * TRANS, "fps": 30}, "its hips move 39 times its height a second"),
        ({"poses": np.zeros((4, 72)), "trans": np.zeros((3, 3))}, r"4 poses and trans \(3, 3\)"),
        ({"body_pose": np.zeros((4, 30)), "transl": np.zeros((4, 3))}, r"body_pose \(4, 30\)"),
        (
            {"global_orient": np.zeros((3, 3)), "body_pose": np.zeros((4, 63)), "transl": np.zeros((4, 3))},
            "global_orient",
        ),
        ({"poses": np.full((4, 72), np.inf), "trans": np.zeros((4, 3))}, "frame 0: values that are not finite"),
        ({"poses": np.array(["x"]), "trans": np.zeros((4, 3))}, "a.npz"),
        ({"poses": np.zeros((0, 72)), "trans": np.zeros((0, 3))}, r"poses \(0, 72\)"),
        ({"poses": np.zeros((4, 72)), "trans": np.zeros((4, 3)), "fps": np.array(0.0)}, "0 frames per second"),
    ],
)
def test_what_is_no_motion_is_refused(stored, complaint, tmp_path) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", **stored)
    with pytest.raises(MotionError, match=rf"a\.npz.*{complaint}|{complaint}"):
        read_take(tmp_path / "a.npz")
