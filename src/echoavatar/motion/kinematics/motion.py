"""Motion as a value; its pose in the world; the same motion at another frame rate.

`forward_kinematics` is batched, one product per tree level (paper, appendix). One departure from the paper's formula:
the root's position is the given world position, not its constant rest offset, so that the result includes the root's
travel. `ik.limbs` is the compiled version for the live stages.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from echoavatar.errors import MotionError
from echoavatar.limits import ROTATIONS
from echoavatar.timing import FRAME_RATE_HZ

from .rotations import matrix_from_quaternion, slerp
from .skeleton import Skeleton

SLOWEST_HZ = 0.1  # least frame rate; with a lower one a short file would last for years
_SAME_RATE = 3e-4  # share by which a measured rate may miss a whole one


class Pose(NamedTuple):
    """World rotation matrices and positions of every joint."""

    rotations: Float[np.ndarray, "*n j 3 3"]
    positions: Float[np.ndarray, "*n j 3"]


def forward_kinematics(
    skeleton: Skeleton, rotations: Float[np.ndarray, "*n j 3 3"], root: Float[np.ndarray, "*n 3"]
) -> Pose:
    """World pose from parent-relative rotations and the root's world position (metres)."""
    world, places = rotations.copy(), np.empty(rotations.shape[:-1], np.result_type(rotations, root))
    places[..., 0, :] = root
    for joints, parents, offsets in skeleton.levels:
        above = world[..., parents, :, :]
        places[..., joints, :] = places[..., parents, :] + (above @ offsets)[..., 0]
        world[..., joints, :, :] = above @ rotations[..., joints, :, :]
    return Pose(world, places)


@dataclass(frozen=True)
class Motion:
    """Frames of one skeleton.

    Attributes:
        skeleton: the rig.
        rotations: (t, j, 4) float32 parent-relative unit quaternions `wxyz`.
        root: (t, 3) float32 world position of the root, metres.
        fps: frames per second.
    """

    skeleton: Skeleton
    rotations: NDArray[np.float32]
    root: NDArray[np.float32]
    fps: float

    def __post_init__(self) -> None:
        """Raise MotionError: shapes do not fit, no frames, values are not finite, or an impossible frame rate."""
        t, joints = self.frames, self.skeleton.joints
        if t == 0:
            raise MotionError("the motion has no frames; record it again or choose another")
        if self.rotations.shape != (t, joints, 4) or self.root.shape != (t, 3):
            raise MotionError(
                f"rotations {self.rotations.shape} and root {self.root.shape} do not fit {joints} joints;"
                f" expected ({t}, {joints}, 4) and ({t}, 3)"
            )
        if not (np.isfinite(self.rotations).all() and np.isfinite(self.root).all()):
            raise MotionError("the motion holds values that are not finite; repair these frames or leave them out")
        _check_rate(self.fps)

    @classmethod
    def at_rest(cls, skeleton: Skeleton) -> "Motion":
        """One frame of the rest pose, where the skeleton stands."""
        still = np.tile(np.array([1, 0, 0, 0], np.float32), (1, skeleton.joints, 1))
        return cls(skeleton, still, skeleton.offsets[:1], FRAME_RATE_HZ)

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return int(self.root.shape[0])

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return self.frames / self.fps

    def matrices(self) -> Float[np.ndarray, "t j 3 3"]:
        """Parent-relative rotation matrices."""
        return matrix_from_quaternion(self.rotations)

    def pose(self, dtype: type[np.floating] = np.float32) -> Pose:
        """World rotations and positions of every joint and frame; the sums along the tree are in `dtype`."""
        return forward_kinematics(self.skeleton, self.matrices().astype(dtype), self.root.astype(dtype))

    def cut(self, start: int, stop: int) -> "Motion":
        """Frames `start` to `stop`, which is not included."""
        return replace(self, rotations=self.rotations[start:stop], root=self.root[start:stop])

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Plain arrays: `rotations` (t, j, 4) `wxyz`, `root` (t, 3) in metres, `fps`, `joints` and `parents` (j)."""
        return {
            "rotations": self.rotations,
            "root": self.root,
            "fps": np.array(self.fps),
            "joints": np.array(self.skeleton.names),
            "parents": np.array(self.skeleton.parents),
        }


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another frame rate. It begins at the first frame and ends at or before the last.

    Frames at an instant that both rates share are copied exactly.

    Raises MotionError: `fps` is not a frame rate, or gives more frames than a motion may have.
    """
    _check_rate(fps)
    ratio = frame_ratio(motion.fps, fps)
    count = int((motion.frames - 1) / ratio) + 1
    if count * motion.skeleton.joints > ROTATIONS:
        raise MotionError(f"{motion.seconds:.0f} s at {fps:g} frames per second are too many frames; cut the motion")
    steps = np.arange(count, dtype=np.int64) * ratio.numerator
    index = np.minimum(steps // ratio.denominator, motion.frames - 1)
    share = (steps % ratio.denominator) / ratio.denominator
    after = np.minimum(index + 1, motion.frames - 1)
    source = motion.rotations.astype(np.float64)
    between = slerp(source[index], source[after], share[:, None]).astype(np.float32)
    is_shared = share == 0
    rotations = np.where(is_shared[:, None, None], motion.rotations[index], between)
    root = catmull_rom(motion.root, index, share)
    exact = np.where(is_shared[:, None], motion.root[index], root.astype(np.float32))
    return Motion(motion.skeleton, rotations, exact, fps)


def align_signs(quaternions: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """The same rotations, with signs chosen so that interpolation between frames takes the short way."""
    is_flipped = (quaternions[1:] * quaternions[:-1]).sum(-1) < 0
    sign = np.where(np.cumsum(is_flipped, axis=0) % 2 == 1, np.float32(-1), np.float32(1))
    return np.concatenate([quaternions[:1], quaternions[1:] * sign[..., None]])


def usual_rate(fps: float) -> float:
    """The whole or NTSC rate that a measured or rounded one means, such as 30000/1001 for 29.97; else itself."""
    return float(round(fps)) if abs(round(fps) - fps) < _SAME_RATE * fps else float(_fraction(fps))


def frame_ratio(source_fps: float, fps: float) -> Fraction:
    """Source frames per new frame, exactly; 29.97 means 30000/1001, and likewise 23.976 and 59.94."""
    return _fraction(source_fps) / _fraction(fps)


def _check_rate(fps: float) -> None:
    if not SLOWEST_HZ <= fps < 10_000:
        raise MotionError(f"{fps:g} frames per second is not a frame rate; give one of {SLOWEST_HZ} to 10,000")


def _fraction(fps: float) -> Fraction:
    exact = Fraction(fps).limit_denominator(1001)
    film = Fraction(round(fps * 1001), 1001)
    is_film = film.numerator % 1000 == 0 and abs(float(film) - fps) < 5e-3 and exact.denominator != 1
    return film if is_film else exact


def catmull_rom(
    values: Float[np.ndarray, "t ..."], index: Int[np.ndarray, " n"], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n ..."]:
    """A cubic between frames `index` and `index` + 1, in double precision; it continues straight at both ends."""
    wide = values.astype(np.float64)
    first, last = (2 * wide[:1] - wide[1:2], 2 * wide[-1:] - wide[-2:-1]) if len(wide) > 1 else (wide, wide)
    wide = np.concatenate([first, wide, last, last])
    a, b, c, d = (wide[index + k] for k in range(4))
    u = share.reshape(-1, *([1] * (values.ndim - 1)))
    curve: np.ndarray = b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    return curve
