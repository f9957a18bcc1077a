"""Statistics of a motion, to compare rehearsed and generated motion with recorded motion.

Hand speeds are measured in the frame of the hips (position and heading), so that walking does not count as gesturing.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics.motion import Motion, Pose
from echoavatar.motion.kinematics.rigs import bone_map, known_bones
from echoavatar.motion.kinematics.rotations import angle_between
from echoavatar.motion.kinematics.skeleton import Skeleton
from echoavatar_lab.data.faults import DIGITS, skate

PAUSE_SPEED = 0.06  # metres per second; a slower hand rests
STROKE_SPEED = 0.35  # metres per second; a peak above it is a stroke
TURNED_DEG = 60.0  # a foot that points further away from where the hips face is turned
FASTEST = "joint_speed_max_deg_s"  # of whose values the largest is taken, not the mean
_FEET = ("leftFoot", "leftToes", "rightFoot", "rightToes")
_LEGS = ("hips", "leftLowerLeg", "leftFoot", "leftToes", "rightLowerLeg", "rightFoot", "rightToes")
_Array = np.ndarray


def describe(motion: Motion) -> dict[str, float]:
    """Statistics of a motion of at least four frames. Units are in the names; left and right are taken together.

    `leg_energy_m2_s2` is the mean squared world speed of hips, knees, ankles and toes; `stroke_rate_hz` counts
    peaks of hand speed over 0.35 m/s per second and hand; `pause_ratio` is the share of frames in which both hands
    move at less than 6 cm/s; `reach_ratio` is the distance from shoulder to wrist in arm lengths; jerk is the mean
    length of the third derivative of position; skate as in `faults.skate`, over ankles and toes.
    `turned_feet_ratio` is the share of feet that point over 60 degrees away from where the hips face, NaN for a rig
    without toes.
    """
    if motion.frames < 4:
        raise ValueError(f"statistics need four frames, got {motion.frames}")
    bones, pose, fps = bone_map(motion.skeleton), motion.pose(), motion.fps
    places, local, head = pose.positions.astype(np.float64), motion.matrices(), pose.rotations[:, bones["head"]]
    hands, shoulders = ([bones[side + bone] for side in ("left", "right")] for bone in ("Hand", "UpperArm"))
    speed = _speed(own_frame(bones, pose)[:, hands], fps)
    is_peak = (speed[1:-1] > speed[:-2]) & (speed[1:-1] >= speed[2:]) & (speed[1:-1] > STROKE_SPEED)
    reach = np.linalg.norm(places[:, hands] - places[:, shoulders], axis=-1) / arm_length(motion.skeleton)
    turn = np.degrees(angle_between(local[:-1], local[1:])) * fps
    fingers = [joint for bone, joint in bones.items() if any(digit in bone for digit in DIGITS)]
    body, legs, feet = (
        places[:, sorted({bones[name] for name in names if name in bones})] for names in (bones, _LEGS, _FEET)
    )
    return {
        "wrist_speed_mean_m_s": float(speed.mean()),
        "wrist_speed_p95_m_s": float(np.percentile(speed, 95)),
        "wrist_height_mean_m": float((places[:, hands, 1] - places[:, bones["hips"], None, 1]).mean()),
        "reach_ratio_mean": float(reach.mean()),
        "pause_ratio": float((speed.max(-1) < PAUSE_SPEED).mean()),
        "stroke_rate_hz": float(is_peak.sum() / 2 / motion.seconds),
        "finger_speed_mean_deg_s": float(turn[:, fingers].mean()) if fingers else 0.0,
        "head_speed_mean_deg_s": float(np.degrees(angle_between(head[:-1], head[1:])).mean() * fps),
        "leg_energy_m2_s2": float((_speed(legs, fps) ** 2).mean()),
        FASTEST: float(turn.max()),
        "body_jerk_mean_m_s3": float(np.linalg.norm(np.diff(body, n=3, axis=0), axis=-1).mean() * fps**3),
        "skate_cm_s": skate(feet, fps, standing_height=_standing_heights(motion, bones)),
        "turned_feet_ratio": float(turned_feet(motion).mean()),
    }


def wrist_speeds(motion: Motion) -> _Array:
    """(t - 1, 2) speed of left and right wrist in the frame of the hips, metres per second."""
    bones, pose = bone_map(motion.skeleton), motion.pose()
    return _speed(own_frame(bones, pose)[:, [bones["leftHand"], bones["rightHand"]]], motion.fps)


def turned_feet(motion: Motion) -> Float[np.ndarray, "t 2"]:
    """1 where a foot (left, right) points over 60 degrees away from where the hips face; NaN for a rig without toes."""
    bones = known_bones(motion.skeleton)
    if not {"leftToes", "rightToes"} <= bones.keys():
        return np.full((motion.frames, 2), np.nan)
    own = own_frame(bones, motion.pose())
    along = own[:, [bones["leftToes"], bones["rightToes"]]] - own[:, [bones["leftFoot"], bones["rightFoot"]]]
    turn = np.abs(np.degrees(np.arctan2(along[..., 0], along[..., 2])))
    return np.asarray(turn > TURNED_DEG, np.float64)


def arm_length(skeleton: Skeleton) -> float:
    """Length of upper arm plus forearm, mean of both sides, metres."""
    bones = bone_map(skeleton)
    joints = [bones[f"{side}{bone}"] for side in ("left", "right") for bone in ("LowerArm", "Hand")]
    return float(np.linalg.norm(skeleton.offsets[joints], axis=-1).sum() / 2)


def own_frame(bones: dict[str, int], pose: Pose) -> _Array:
    """Positions (t, j, 3) relative to the hips, turned about the vertical so that the hips face +Z."""
    places = pose.positions.astype(np.float64)
    across = places[:, bones["leftUpperLeg"]] - places[:, bones["rightUpperLeg"]]
    left = across[:, [0, 2]] / np.linalg.norm(across[:, [0, 2]], axis=-1, keepdims=True).clip(1e-9)
    relative = places - places[:, bones["hips"], None]
    x, z = relative[..., 0], relative[..., 2]
    cosine, sine = left[:, None, 0], left[:, None, 1]
    return np.stack([x * cosine + z * sine, relative[..., 1], z * cosine - x * sine], -1)


def _standing_heights(motion: Motion, bones: dict[str, int]) -> _Array | None:
    """Heights of ankles and toes on the floor, from the rest pose; None, to be measured, if it is not on y = 0."""
    rest = motion.skeleton.rest_positions.astype(np.float64)
    heights = rest[[bones[name] for name in _FEET if name in bones], 1]
    is_on_floor = 0 < heights.min() < 0.05 and heights.max() < 0.2
    return heights if is_on_floor else None


def _speed(places: _Array, fps: float) -> _Array:
    speed: _Array = np.linalg.norm(np.diff(places, axis=0), axis=-1) * fps
    return speed
