"""Write BVH: the rest offsets of every joint, then the root's place and the Euler angles of each frame."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echoavatar.errors import MotionError
from echoavatar.whole_file import write_whole

from ..kinematics.motion import Motion
from ..kinematics.rotations import euler_from_matrix, matrix_from_quaternion
from ..kinematics.skeleton import Skeleton
from ..kinematics.upright import OURS, Stand, turned

_Frames = np.ndarray


def write_bvh(
    path: Path | str,
    skeleton: Skeleton,
    rotations: NDArray[np.float32],
    root: NDArray[np.float32],
    fps: float,
    *,
    stand: Stand = OURS,
    order: str = "zyx",
) -> None:
    """Write a BVH file, completely or not at all. Euler angles continue past 180 degrees instead of jumping.

    Args:
        path: where to write.
        skeleton: the rig; its tips become End Sites.
        rotations: (t, j, 4) parent-relative quaternions `wxyz`.
        root: (t, 3) world position of the root, metres.
        fps: frames per second.
        stand: the unit and axes of the file (`read_standing`); ours in centimetres by default.
        order: order of the rotation channels.
    """
    motion = Motion(skeleton, np.asarray(rotations, np.float32), np.asarray(root, np.float32), fps)
    motion, scale = turned(motion, stand.rest.T, stand.world.T), 1 / stand.metres
    hierarchy, listed = _hierarchy(motion.skeleton, scale, order)
    angles = np.degrees(_continuous_euler(motion.rotations, order))[:, listed].reshape(motion.frames, -1)
    table = np.concatenate([motion.root.astype(np.float64) * scale, angles], 1)
    row = " ".join(["%.6f"] * table.shape[1])
    lines = ["HIERARCHY", *hierarchy, "MOTION", f"Frames: {motion.frames}"]
    lines += [f"Frame Time: {1 / fps:.9f}", *(row % tuple(frame) for frame in table.tolist())]
    write_whole(path, "\n".join(lines) + "\n", error=MotionError)


def _continuous_euler(rotations: NDArray[np.float32], order: str) -> _Frames:
    """Angles (t, j, 3) in radians. Of the two triples for a rotation, the one nearer to the last frame's is taken."""
    plain = euler_from_matrix(matrix_from_quaternion(rotations.astype(np.float64)), order)
    other = plain * [1, -1, 1] + np.pi
    angles = plain.copy()
    for t in range(1, len(angles)):
        last = angles[t - 1]
        near = plain[t] + 2 * np.pi * np.round((last - plain[t]) / (2 * np.pi))
        far = other[t] + 2 * np.pi * np.round((last - other[t]) / (2 * np.pi))
        is_far = np.abs(far - last).sum(-1) < np.abs(near - last).sum(-1)
        angles[t] = np.where(is_far[:, None], far, near)
    return angles


def _hierarchy(skeleton: Skeleton, scale: float, order: str) -> tuple[list[str], list[int]]:
    """The lines of the HIERARCHY block, and the joints in their order."""
    axes = " ".join(f"{axis.upper()}rotation" for axis in order)
    offsets = skeleton.offsets.astype(np.float64) * scale
    tips = skeleton.config.tips
    lines, listed = list[str](), list[int]()

    def put(joint: int, depth: int) -> None:
        listed.append(joint)
        pad, inner = "\t" * depth, "\t" * (depth + 1)
        name = skeleton.names[joint]
        lines.append(f"{pad}{'ROOT' if depth == 0 else 'JOINT'} {name}")
        lines.extend([f"{pad}{{", f"{inner}OFFSET {_words(offsets[joint])}"])
        travel = "6 Xposition Yposition Zposition" if depth == 0 else "3"
        lines.append(f"{inner}CHANNELS {travel} {axes}")
        below = [j for j in range(skeleton.joints) if skeleton.parents[j] == joint]
        for child in below:
            put(child, depth + 1)
        if not below or name in tips:
            tip = np.multiply(tips.get(name, (0.0, 0.0, 0.0)), scale)
            lines.extend([f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {_words(tip)}", f"{inner}}}"])
        lines.append(f"{pad}}}")

    put(0, 0)
    return lines, listed


def _words(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
