import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.framing import SIZES, VIEWS, View, path
from echoavatar.files.avatar.render import Camera
from echoavatar.motion.kinematics import HUMANOID, Motion

FPS = 30.0
MAYA = load_character()
BODY: list[View] = [view for view in VIEWS if view not in ("bust", "face")]


def turned(frames: int, lifted: np.ndarray) -> np.ndarray:
    """Rotations: both arms hang at 0 and are straight up at 1."""
    turns = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    turns[..., 0] = 1
    half = (lifted - 0.5) * np.pi / 2
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, HUMANOID.index(f"{side}UpperArm")] = np.stack(
            [np.cos(half), 0 * half, 0 * half, sign * np.sin(half)], 1
        )
    return turns


def dance(seconds: float = 24.0, period: float = 6.0) -> Motion:
    """Travels 1.5 m to each side and to the camera and back, and lifts the hands twice."""
    t = np.arange(round(seconds * FPS)) / FPS
    root = np.tile(HUMANOID.rest_positions[0], (len(t), 1))
    root[:, 0] += 1.5 * np.sin(2 * np.pi * t / period)
    root[:, 2] += 1.5 * np.sin(2 * np.pi * t / (1.7 * period))
    return Motion(HUMANOID, turned(len(t), np.clip(np.sin(2 * np.pi * t / 11), 0, 1)), root.astype(np.float32), FPS)


def filmed(motion: Motion, view: View, size: tuple[int, int]) -> tuple[list[Camera], np.ndarray]:
    """The cameras, and the joints in the picture: -1 to 1 from its left to its right and from its bottom to its top."""
    pose = motion.pose()
    rotations, positions = pose.rotations, pose.positions
    cameras = path(view, size, MAYA, rotations, positions, motion.fps)
    seen = []
    for camera, points in zip(cameras, positions, strict=True):
        x, y, z = camera.axes @ (points - camera.position).T
        assert (z < -0.5).all()
        high = -z * np.tan(camera.field_of_view / 2)
        seen.append(np.stack([x / high * size[1] / size[0], y / high], 1))
    return cameras, np.array(seen)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
@pytest.mark.parametrize("view", BODY)
def test_all_of_the_body_is_seen_all_the_time_and_large(view: View, size: tuple[int, int]) -> None:
    """A margin of 3 % is free around the joints, and from feet to head or hands the body fills half of the height."""
    _, seen = filmed(dance(), view, size)
    assert np.abs(seen).max() < 0.94
    height = (seen[..., 1].max(1) - seen[..., 1].min(1)) / 2
    assert height.mean() > (0.5 if size[0] >= size[1] else 0.4)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_camera_neither_turns_nor_shakes(size: tuple[int, int]) -> None:
    """It starts and stops softly: in a second its speed changes by less than that of a slow step."""
    cameras, _ = filmed(dance(), "front", size)
    axes = np.array([camera.axes for camera in cameras])
    np.testing.assert_allclose(axes, np.broadcast_to(axes[0], axes.shape), atol=1e-9)
    places = np.array([camera.position for camera in cameras])
    assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() * FPS**2 < 4.0


def test_a_wide_picture_lets_the_body_walk() -> None:
    """Steps of half a metre to the sides move no camera, and the feet and the head stay large."""
    motion = dance()
    root = HUMANOID.rest_positions[0] + (motion.root - motion.root.mean(0)) * [0.33, 0, 0]
    cameras, seen = filmed(
        Motion(HUMANOID, turned(len(root), np.zeros(len(root))), root.astype(np.float32), FPS), "front", SIZES["wide"]
    )
    assert len({camera.position for camera in cameras}) == 1
    assert (seen[..., 1].max(1) - seen[..., 1].min(1)).min() / 2 > 0.7


def test_a_child_and_a_giant_are_as_large_as_others() -> None:
    from dataclasses import replace

    from echoavatar.motion.kinematics.upright import scaled

    pose = Motion(HUMANOID, turned(1, np.zeros(1)), HUMANOID.rest_positions[:1], FPS).pose()
    for times in (0.3, 4.0):
        other = replace(MAYA, positions=MAYA.positions * np.float32(times), skeleton=scaled(HUMANOID, times))
        for view in VIEWS:
            near, far = (
                path(view, (720, 720), who, pose.rotations, pose.positions * np.float32(scale), FPS)[0]
                for who, scale in ((MAYA, 1), (other, times))
            )
            np.testing.assert_allclose(far.position, times * np.array(near.position), rtol=1e-3, atol=1e-3)
