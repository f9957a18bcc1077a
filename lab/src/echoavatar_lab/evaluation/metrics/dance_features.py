"""FID_k and FID_g: how far generated dances are from true ones by hand-made features (AIST++, Bailando).

Li et al., "AI Choreographer" (ICCV 2021, arXiv 2101.08779) score dances by the Fréchet distance of two features of a
whole clip. Both come from fairmotion:

- kinetic, FID_k (Onuma et al., 2008): for each joint the mean squared horizontal speed, the mean squared vertical
  speed and the mean acceleration, of velocities averaged over five steps;
- geometric, FID_g (Müller et al., 2005): the share of frames in which each of 32 relations holds between joints, such
  as "the right hand is above the neck" or "the left knee is bent".

Joints are the 24 of SMPL, Y is up, the clip's first root is the origin, motion is at 60 frames a second. As published,
the geometric speeds assume 120, and lengths are SMPL's, not the body's. Bailando (Siyao et al., CVPR 2022) scales both
sides by the truth's mean and deviation before the distance; so do we. Compare values of one test set and equal lengths.
"""

from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.motion.kinematics import HUMANOID

RATE_HZ = 60
LONGEST_S = 20  # Bailando looks at the first 20 s of a dance
_GEOMETRIC_HZ, _AROUND = 120, 2
_ARM, _SHOULDERS, _HIPS = (
    0.2568381,
    0.3908484,
    0.1192471,
)  # metres of SMPL's rest pose: upper arm, shoulder line, hip line
ROOT, BELLY, CHEST, NECK = 0, 3, 9, 12
LEFT = {"hip": 1, "knee": 4, "ankle": 7, "toes": 10, "shoulder": 16, "elbow": 18, "wrist": 20}
RIGHT = {"hip": 2, "knee": 5, "ankle": 8, "toes": 11, "shoulder": 17, "elbow": 19, "wrist": 21}
_LEGS, _ARMS = ("UpperLeg", "LowerLeg", "Foot", "Toes"), ("UpperArm", "LowerArm", "Hand", "MiddleProximal")
_BOTH = ("left", "right")
_SPINE = ("spine", "chest", "upperChest")
SMPL = (
    "hips",
    *(name for leg, bone in zip(_LEGS, _SPINE, strict=False) for name in (*(side + leg for side in _BOTH), bone)),
    *(side + _LEGS[3] for side in _BOTH),
    "neck",
    *(side + "Shoulder" for side in _BOTH),
    "head",
    *(side + arm for arm, side in product(_ARMS, _BOTH)),
)
"""SMPL's joints in its order, by the names of our rig."""

Positions = Float[np.ndarray, "t 24 3"]
Track = Float[np.ndarray, "t 3"]


def smpl_positions(positions: Float[np.ndarray, "t 52 3"]) -> Positions:
    """Of positions of our rig those of `SMPL`, from the first root on."""
    return np.asarray(positions[:, HUMANOID.indices(SMPL)] - positions[:1, :1])


def kinetic(positions: Positions, fps: float = RATE_HZ, *, is_published: bool = True) -> Float[np.ndarray, " 72"]:
    """Of each joint: squared horizontal and vertical speed, (m/s)^2, and acceleration, m/s2; means over the frames.

    The published acceleration has a misplaced bracket: it divides the earlier place by the time of a frame, and not the
    step from it, so that it measures the distance from the first root. False gives the acceleration that was meant.
    """
    steps = np.diff(positions, axis=0)
    speed = _around(steps, len(steps)) * fps
    earlier = positions[1:-1] - positions[:-2] * fps if is_published else steps[:-1] * fps
    bend = _around(steps[1:] * fps - earlier, len(steps)) * fps
    flat, up = np.square(speed[..., [0, 2]]).sum(-1).mean(0), np.square(speed[..., 1]).mean(0)
    return np.stack([flat, up, np.linalg.norm(bend, axis=-1).mean(0)], 1).ravel()


def geometric(positions: Positions) -> Float[np.ndarray, " 32"]:
    """The share of frames, from the second on, in which each relation holds."""
    now, floor = positions[1:], np.zeros((len(positions) - 1, 3))
    floor[:, 1] = now[..., 1].min(1)
    up, steps = np.array([0.0, 1.0, 0.0]), np.diff(positions, axis=0)
    sides = ((RIGHT, LEFT), (LEFT, RIGHT))

    def at(joint: int) -> Track:
        return now[:, joint]

    def along(normal: Track, start: Track, point: Track) -> Float[np.ndarray, " t"]:
        """How far a point lies beyond the plane through `start`."""
        return np.asarray(((point - start) * normal).sum(-1) / np.linalg.norm(normal, axis=-1))

    def rush(joint: int, of: int, way: Track) -> Float[np.ndarray, " t"]:
        """Speed of a joint along a way, as seen from another."""
        return along(way, np.zeros(3), steps[:, joint] - steps[:, of]) * _GEOMETRIC_HZ

    def fast(joint: int) -> Float[np.ndarray, " t"]:
        return np.asarray(np.linalg.norm(steps[:, joint], axis=-1) * _GEOMETRIC_HZ)

    def angle(one: Track, other: Track, low: float, high: float) -> Bool[np.ndarray, " t"]:
        cosine = (one * other).sum(-1) / (np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1))
        found = np.degrees(np.arccos(cosine))
        return np.asarray((found > low) & (found < high))

    def bent(own: dict[str, int], root: str, hinge: str, end: str) -> Bool[np.ndarray, " t"]:
        return angle(at(own[root]) - at(own[hinge]), at(own[end]) - at(own[hinge]), 0, 110)

    def plane(a: int, b: int, c: int) -> Track:
        return np.asarray(np.cross(at(c) - at(a), at(b) - at(a)))

    trunk, arm = at(ROOT) - at(NECK), _ARM
    left, right = LEFT["wrist"], RIGHT["wrist"]
    relations = [
        *(rush(own["wrist"], NECK, plane(NECK, own["hip"], other["hip"])) > 1.8 * arm for own, other in sides),
        *(along(at(NECK) - at(CHEST), at(NECK), at(own["wrist"])) > 0.2 * arm for own, _ in sides),
        *[rush(CHEST, BELLY, at(CHEST) - at(BELLY)) > 1.8 * arm] * 2,  # as published: the hands do not enter
        *(bent(own, "shoulder", "elbow", "wrist") for own, _ in sides),
        along(at(RIGHT["shoulder"]) - at(LEFT["shoulder"]), at(left), at(right)) > 2.5 * _SHOULDERS,
        rush(right, left, at(right) - at(left)) > 1.4 * arm,
        rush(left, right, at(ROOT) - at(right)) > 1.4 * arm,
        rush(right, left, at(ROOT) - at(left)) > 1.4 * arm,
        *(fast(own["wrist"]) > 2.5 * arm for own, _ in sides),
        *(along(plane(ROOT, o["hip"], o["toes"]), at(ROOT), at(own["ankle"])) > 0.38 * arm for own, o in sides),
        *(along(up, floor, at(own["ankle"])) > 1.2 * arm for own, _ in sides),
        along(at(RIGHT["hip"]) - at(LEFT["hip"]), at(LEFT["ankle"]), at(RIGHT["ankle"])) > 2.1 * _HIPS,
        *(bent(own, "hip", "knee", "ankle") for own, _ in sides),
        *(fast(own["ankle"]) > 2.5 * arm for own, _ in sides),
        *(angle(trunk, at(own["elbow"]) - at(own["shoulder"]), 25, 180) for own, _ in sides),
        *(angle(trunk, at(own["knee"]) - at(own["hip"]), 50, 180) for own, _ in sides),
        along(plane(RIGHT["ankle"], NECK, LEFT["ankle"]), at(RIGHT["ankle"]), at(ROOT)) > 0.5 * arm,
        angle(trunk, np.broadcast_to(up, trunk.shape), 70, 110),
        *(along(-up, floor, at(own["wrist"])) > -1.2 * arm for own, _ in sides),
        fast(ROOT) > 2.3 * arm,
    ]
    return np.asarray(np.stack(relations).mean(1))


def _around(values: Float[np.ndarray, "s j 3"], frames: int) -> Float[np.ndarray, "f j 3"]:
    """Mean over the values up to two away from each frame, as far as there are any."""
    sums = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
    place = np.arange(frames)
    first, last = np.maximum(place - _AROUND, 0), np.minimum(place + _AROUND + 1, len(values))
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None, None])
