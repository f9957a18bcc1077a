"""How much a body moves and varies, as nine statistics of a window of motion, and those of people. Not in the paper.

Hands are measured in the frame of the shoulders and in arm lengths (shoulder to wrist), so that rigs and bodies of any
size compare. Lengths of the whole body are scaled so that the head joint is 1.5 m above the ankle. Lean and sway are
taken along the world's axes: a clip should face +Z. docs/metrics.md has the formulas.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rigs import known_bones

STATISTICS = {
    "hand_speed": "arm lengths/s",
    "hands_still": "",
    "hands_at_work": "",
    "room": "cubes in 20 s",
    "novelty": "arm lengths",
    "shoulder_turn": "deg",
    "trunk_lean": "deg",
    "hip_sway": "cm",
    "ankle_speed": "m/s",
}
"""Names of the statistics and their units."""
POINTS = (
    "hips",
    "head",
    *(side + bone for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "Foot") for side in ("left", "right")),
)
STILL, AT_WORK = 0.1, 0.35  # arm lengths a second
RESTS = 0.55  # arm lengths a second, 0.3 m/s of a grown-up: arms under it hang or are held
CUBE = 0.15  # arm lengths
ROOM_S, APART_S = 20, 3
HEAD_OVER_ANKLE_M = 1.5
_PATH_HZ = 10

Points = Float[np.ndarray, "t p 3"]


def body_points(motion: Motion, names: Sequence[str] = POINTS) -> Points:
    """World positions of `POINTS` and further bones, scaled to a body of common height.

    The wrist may be the tip of the lower arm. Raises MotionError if the rig is not known.
    """
    skeleton, pose, bones = motion.skeleton, motion.pose(), known_bones(motion.skeleton)
    found = []
    for point in names:
        if (at := bones.get(point)) is not None:
            found.append(pose.positions[:, at])
        elif point.endswith("Hand") and (arm := bones.get(point.replace("Hand", "LowerArm"))) is not None:
            tip = np.array(skeleton.config.tips.get(skeleton.names[arm], (0, 0, 0)), np.float32)
            found.append(pose.positions[:, arm] + pose.rotations[:, arm] @ tip)
        else:
            raise MotionError(f"no joint of the rig is known to be {point}")
    return of_common_height(np.stack(found, 1).astype(np.float64))


def of_common_height(points: Points) -> Points:
    """World positions of `POINTS` (and others behind them), scaled so that the head joint is 1.5 m above the ankle.

    Raises MotionError if the head is not above the ankles.
    """
    ankles = points[:, [POINTS.index("leftFoot"), POINTS.index("rightFoot")], 1].min(1)
    height = float(np.median(points[:, POINTS.index("head"), 1] - ankles))
    if height <= 0:
        raise MotionError("the head is not above the ankles; turn the motion upright (Y up)")
    return points * (HEAD_OVER_ANKLE_M / height)


def windows(points: Float[np.ndarray, "t ..."], fps: float, seconds: float) -> Iterator[Float[np.ndarray, "n ..."]]:
    """Whole windows one after another; a shorter clip is one window."""
    length = int(seconds * fps)
    for start in range(0, max(len(points) - length, 0) + 1, length):
        yield points[start : start + length]


def liveliness(points: Points, fps: float, *, apart_s: float = APART_S) -> dict[str, float]:
    """The statistics of one window, by the names of `STATISTICS`; `apart_s` is for windows too short for `novelty`."""
    hands = hand_paths(points)
    speeds = np.stack([path_speed(hands[:, hand], fps) for hand in range(2)])
    return {
        "hand_speed": float(speeds.mean()),
        "hands_still": float((speeds < STILL).all(0).mean()),
        "hands_at_work": float((speeds > AT_WORK).all(0).mean()),
        "room": room(hands, fps),
        "novelty": novelty(hands, fps, apart_s),
        "shoulder_turn": shoulder_turn_deg(points),
        "trunk_lean": trunk_lean_deg(points),
        "hip_sway": hip_sway_cm(points, fps),
        "ankle_speed": float(np.mean([path_speed(ankle, fps) for ankle in np.moveaxis(foot_paths(points), 1, 0)])),
    }


def arm_rests(points: Points, fps: float, counts: Bool[np.ndarray, " steps"] | None = None) -> tuple[float, float]:
    """Longest time for which both wrists are slower than `RESTS`, seconds, and the share of the time that they are.

    Only steps between frames that `counts` marks count, and the others end a rest; without it all do.
    """
    speeds = np.stack([path_speed(hand, fps) for hand in np.moveaxis(hand_paths(points), 1, 0)])
    of = np.ones(speeds.shape[1], bool) if counts is None else counts
    rests = (speeds < RESTS).all(0) & of
    ends = np.flatnonzero(np.concatenate([[True], ~rests, [True]]))
    return float((np.diff(ends) - 1).max() / fps), float(rests.sum() / max(of.sum(), 1))


def foot_paths(points: Points) -> Float[np.ndarray, "t 2 3"]:
    """Both ankles in the world, metres of a body of common height."""
    return points[:, [POINTS.index("leftFoot"), POINTS.index("rightFoot")]]


def hand_paths(points: Points) -> Float[np.ndarray, "t 2 3"]:
    """Both wrists in the shoulders' frame, arm lengths: origin between the shoulders, X along them, Y up."""
    middle = (_at(points, "leftUpperArm") + _at(points, "rightUpperArm")) / 2
    hands = points[:, [POINTS.index("leftHand"), POINTS.index("rightHand")]]
    return in_shoulder_frame(points, (hands - middle[:, None]) / arm_length(points))


def arm_length(points: Points) -> float:
    """From shoulder over elbow to wrist, left; median over the frames."""
    shoulder, elbow, wrist = (_at(points, "left" + bone) for bone in ("UpperArm", "LowerArm", "Hand"))
    return float(np.median(np.linalg.norm(shoulder - elbow, axis=1) + np.linalg.norm(elbow - wrist, axis=1)))


def in_shoulder_frame(points: Points, vectors: Float[np.ndarray, "t *p 3"]) -> Float[np.ndarray, "t *p 3"]:
    """Vectors turned about the vertical, so that X runs along the shoulders to the left."""
    turn = yaw(_at(points, "leftUpperArm") - _at(points, "rightUpperArm")).reshape(-1, *[1] * (vectors.ndim - 2))
    (x, y, z), cos, sin = np.moveaxis(vectors, -1, 0), np.cos(turn), np.sin(turn)
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], -1)


def path_speed(path: Float[np.ndarray, "t 3"], fps: float) -> Float[np.ndarray, " steps"]:
    """Speed along a path that is smoothed by a Gaussian of 1/30 s."""
    return np.asarray(np.linalg.norm(np.diff(gaussian_filter1d(path, fps / 30, axis=0), axis=0), axis=1) * fps)


def room(hands: Float[np.ndarray, "t 2 3"], fps: float) -> float:
    """Cubes of `CUBE` that the wrists visit in 20 s, each counted for itself; mean over stretches 10 s apart."""
    length = min(int(ROOM_S * fps), len(hands))
    cubes = np.floor(hands / CUBE).astype(int)
    starts = range(0, len(hands) - length + 1, max(length // 2, 1))
    visited = [sum(len(np.unique(cubes[at : at + length, hand], axis=0)) for hand in range(2)) for at in starts]
    return float(np.mean(visited))


def novelty(hands: Float[np.ndarray, "t 2 3"], fps: float, apart_s: float = APART_S) -> float:
    """Mean distance (root mean square) of each second of the hands' path from the most similar second that far away.

    NaN if some second has no other over `apart_s` away.
    """
    path = gaussian_filter1d(hands.reshape(len(hands), -1), 2, axis=0)[:: max(1, int(fps / _PATH_HZ))]
    seconds = np.stack([path[at : at + _PATH_HZ].ravel() for at in range(max(len(path) - _PATH_HZ, 1))])
    number = np.arange(len(seconds))
    is_far = np.abs(number[:, None] - number) > apart_s * _PATH_HZ
    if not is_far.any(1).all():
        return float("nan")
    apart = cdist(seconds, seconds) / np.sqrt(seconds.shape[1])
    return float(np.where(is_far, apart, np.inf).min(1).mean())


def shoulder_turn_deg(points: Points) -> float:
    """Deviation of the angle about the vertical between the lines through the shoulders and through the hip joints."""
    shoulders, hips = (_at(points, "left" + bone) - _at(points, "right" + bone) for bone in ("UpperArm", "UpperLeg"))
    return float(np.degrees(np.unwrap(yaw(shoulders) - yaw(hips)).std()))


def trunk_lean_deg(points: Points) -> float:
    """Deviation of the trunk's lean along Z: from the hips to the middle of the shoulders."""
    trunk = (_at(points, "leftUpperArm") + _at(points, "rightUpperArm")) / 2 - _at(points, "hips")
    return float(np.degrees(np.arctan2(trunk[:, 2], trunk[:, 1])).std())


def hip_sway_cm(points: Points, fps: float) -> float:
    """Deviation of the hips along X about their own mean over some seconds (a Gaussian of 4 s)."""
    side = _at(points, "hips")[:, 0]
    return float(100 * np.std(side - gaussian_filter1d(side, 4 * fps)))


def jerk(points: Points, fps: float) -> float:
    """Mean third derivative (m/s3) of all points about the hips, paths smoothed as the wrists'; not among `STATISTICS`.

    It rises with speed and size as well as with roughness: compare it where hands and ankles are about as fast.
    """
    paths = gaussian_filter1d(points - points[:, :1], fps / 30, axis=0)
    return float(np.linalg.norm(np.diff(paths, n=3, axis=0), axis=-1).mean() * fps**3)


def _at(points: Points, name: str) -> Float[np.ndarray, "t 3"]:
    return points[:, POINTS.index(name)]


def yaw(across: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, " t"]:
    """Angle about the vertical, radians, of a line from the right to the left; 0 where it lies along X."""
    return np.asarray(np.arctan2(-across[:, 2], across[:, 0]))


SPEECH, MUSIC, SILENCE, LISTENING = KINDS = ("speech", "music", "silence", "listening")
