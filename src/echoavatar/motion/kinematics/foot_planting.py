"""Find planted feet, put them on the floor and keep them still by leg IK, without a jerk before or after.

A foot is planted if its joint is near its standing height and has a low VERTICAL speed. Horizontal speed plays no part,
or a sliding foot would pass for a swinging one; `foot_contacts` leaves out fast slides. While a foot is planted, its
toe joint is held in one place at standing height. While the heel is down too, the foot is held level, with one heading.
The correction fades in and out over the frames around. The hips are lowered a little where a leg would not reach.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .easing import smootherstep
from .motion import Motion, Pose, forward_kinematics
from .rigs import bone_map, feet_of
from .rotations import axis_angle_from_quaternion, length, matrix_from_axis_angle, quaternion_from_matrix
from .skeleton import Skeleton
from .two_bone import REACH, Limb, bend_limb
from .windows import weighted_mean, windows

ENTER_HEIGHT_M = 0.020
LEAVE_HEIGHT_M = 0.035
ENTER_SPEED = 0.15  # metres per second, vertical
LEAVE_SPEED = 0.30


def planted(
    positions: NDArray[np.floating], fps: float, *, standing_height: NDArray[np.floating] | float | None = None
) -> NDArray[np.bool_]:
    """Which feet are planted, per frame.

    With hysteresis: a foot is planted once it is within 2 cm of its standing height and moves vertically at less than
    15 cm/s. It is lifted once it is over 3.5 cm above that height or moves vertically faster than 30 cm/s.

    Args:
        positions: (t, f, 3) world positions of ankles, balls or toes, metres.
        fps: frames per second.
        standing_height: height of each joint when its foot is flat on the floor, metres; None takes the 5th
            percentile of its height, which assumes that the foot stands at some time.

    Returns:
        (t, f) True where a foot is planted.
    """
    height = np.asarray(positions, np.float64)[..., 1]
    floor = np.percentile(height, 5, axis=0) if standing_height is None else np.asarray(standing_height)
    over = height - floor
    speed = np.abs(np.gradient(height, axis=0)) * fps if len(height) > 1 else np.zeros_like(height)
    may_enter = (over < ENTER_HEIGHT_M) & (speed < ENTER_SPEED)
    may_stay = (over < LEAVE_HEIGHT_M) & (speed < LEAVE_SPEED)
    is_planted = np.zeros(height.shape, np.bool_)
    state = may_enter[0] if len(height) else np.zeros(height.shape[1], np.bool_)
    for t in range(len(height)):
        state = np.where(state, may_stay[t], may_enter[t])
        is_planted[t] = state
    return is_planted


def sliding(
    positions: NDArray[np.floating], fps: float, *, standing_height: NDArray[np.floating] | float | None = None
) -> float:
    """Mean horizontal speed of planted feet, metres per second; 0 if no foot is ever planted.

    The mean is over all pairs of neighbouring frames in which a foot is planted both times. One still foot and one
    sliding foot give half the sliding foot's speed.
    """
    place = np.asarray(positions, np.float64)
    is_planted = planted(place, fps, standing_height=standing_height)
    stays = is_planted[1:] & is_planted[:-1]
    speed = np.linalg.norm(np.diff(place[..., [0, 2]], axis=0), axis=-1) * fps
    return float(speed[stays].mean()) if stays.any() else 0.0


FADE_SECONDS = 0.25
MAX_SLIDE_SPEED = 0.35  # metres per second; a faster foot steps, or is dragged on purpose
STEP_SECONDS = 0.27  # least time between two stances of one foot
STEP_HEIGHT_M = 0.045  # least height of a step that replaces a slide
LONGEST_STEP_SECONDS = 0.8  # a longer slide is taken to be on purpose
SOFT_FLOOR_M = 0.006
MAX_DRIFT_M = 0.06  # a planted foot that drifts further begins a new stance
_Array = np.ndarray


class Stance(NamedTuple):
    """Frames `start` to `stop` (not included) during which a foot stays in its place."""

    start: int
    stop: int


def settle_feet(motion: Motion, contacts: NDArray[np.bool_] | None = None) -> Motion:
    """The same motion with its feet on the floor (y = 0 of the rig's rest pose) and planted feet still.

    Args:
        motion: a rig with legs of two bones and toes, in metres.
        contacts: (t, 2, 2) left and right, heel and toe, True where they touch the floor; None measures them.
    """
    skeleton, bones = motion.skeleton, bone_map(motion.skeleton)
    rest = skeleton.rest_positions.astype(np.float64)
    rotations, root = motion.matrices().astype(np.float64), motion.root.astype(np.float64)
    legs = [_Leg(skeleton, bones, side, rest) for side in ("left", "right")]
    contacts = foot_contacts(motion) if contacts is None else contacts
    pose = forward_kinematics(skeleton, rotations, root)
    goals = [leg.goal(pose, contacts[:, i], motion.fps) for i, leg in enumerate(legs)]
    root = root - _lowering(legs, goals, pose.positions, motion.fps)
    pose = forward_kinematics(skeleton, rotations, root)
    for leg, goal in zip(legs, goals, strict=True):
        rotations = leg.bring(rotations, pose, goal)
    quaternions = quaternion_from_matrix(rotations).astype(np.float32)
    return replace(motion, rotations=quaternions, root=root.astype(np.float32))


def foot_contacts(motion: Motion, *, stands_on_rest: bool = False, size: float = 1.0) -> NDArray[np.bool_]:
    """Floor contacts (t, 2, 2): left and right, heel and toe. Feet that slide slowly count, fast ones do not.

    Standing heights are measured on the clip, or taken from the rest pose with `stands_on_rest`. `size` is the body's
    size relative to an adult's, because the steps of a small body are lower and slower.
    """
    bones = bone_map(motion.skeleton)
    joints = feet_of(bones)
    places = motion.pose().positions[:, joints].astype(np.float64) / size
    heights = motion.skeleton.rest_positions[joints, 1] / size if stands_on_rest else None
    is_low = planted(places, motion.fps, standing_height=heights)
    speed = np.zeros(places.shape[:2])
    if len(places) > 1:
        speed = np.linalg.norm(np.gradient(places[..., [0, 2]], axis=0), axis=-1) * motion.fps
    both = (is_low & (_smooth(speed, 3) < MAX_SLIDE_SPEED)).reshape(-1, 2, 2)
    both[:, :, 1] |= both[:, :, 0]  # a heel on the floor means a toe on the floor
    return both


def stances(is_planted: NDArray[np.bool_], paths: _Array, fps: float) -> list[Stance]:
    """The stances of a foot, with time for a step between any two.

    A stance ends where one of the foot's points (t, k, 3) has drifted 6 cm. Two stances in nearly the same place, with
    less than a step's time between them, become one.
    """
    step, shortest = max(2, round(STEP_SECONDS * fps)), max(2, round(0.1 * fps))
    pieces: list[Stance] = []
    start = -1
    for t in range(len(is_planted) + 1):
        is_on = t < len(is_planted) and bool(is_planted[t])
        if start >= 0 and (not is_on or _spread(paths[start : t + 1]) > MAX_DRIFT_M):
            pieces.append(Stance(start, t))
            start = -1
        if is_on and start < 0:
            start = t
    found: list[Stance] = []
    for stance in pieces:
        last = found[-1] if found else None
        gap = stance.start - last.stop if last else step
        if last and gap < step and _spread(paths[last.start : stance.stop]) <= MAX_DRIFT_M:
            found[-1] = Stance(last.start, stance.stop)
            continue
        if last and gap < step:
            missing = step - gap
            found[-1] = Stance(last.start, last.stop - missing // 2)
            stance = Stance(stance.start + missing - missing // 2, stance.stop)
            if found[-1].stop - found[-1].start < shortest:
                found.pop()
        if stance.stop - stance.start >= shortest:
            found.append(stance)
    return found


def _spread(paths: _Array) -> float:
    return float(np.ptp(paths[..., [0, 2]], axis=0).max())


class _Leg:
    """Joints and measures of one leg."""

    def __init__(self, skeleton: Skeleton, bones: dict[str, int], side: str, rest: _Array) -> None:
        self.hip, self.knee, self.ankle = (bones[side + name] for name in ("UpperLeg", "LowerLeg", "Foot"))
        self.toes = bones.get(f"{side}Toes", self.ankle)
        self.limb = Limb.of(skeleton, (self.hip, self.knee, self.ankle))
        floor = float(rest[:, 1].min()) if self.toes == self.ankle else 0.0
        self.toe_height = float(rest[self.toes, 1]) - floor
        self.toe_offset = rest[self.toes] - rest[self.ankle]
        self.length = float(length(np.diff(rest[[self.hip, self.knee, self.ankle]], axis=0)).sum())

    def goal(self, pose: Pose, contact: NDArray[np.bool_], fps: float) -> tuple[_Array, _Array]:
        """Corrected world rotation of the foot and position of the ankle."""
        foot, ankle = pose.rotations[:, self.ankle], pose.positions[:, self.ankle]
        points = pose.positions[:, [self.ankle, self.toes]]
        fade = max(1, round(FADE_SECONDS * fps))
        change, is_held = np.zeros_like(ankle), np.zeros(len(ankle), np.bool_)
        for stance in stances(contact[:, 0], points, fps):
            span = slice(stance.start, stance.stop)
            level = _level_mean(foot[span]) @ foot[span].mT
            change[span] = axis_angle_from_quaternion(quaternion_from_matrix(level))
            is_held[span] = True
        foot = matrix_from_axis_angle(_faded(change, is_held, fade)) @ foot
        carried = foot @ self.toe_offset
        path = ankle + carried
        shift, is_held = np.zeros_like(path), np.zeros(len(path), np.bool_)
        found = stances(contact[:, 1], path[:, None], fps)
        for stance in found:
            span = slice(stance.start, stance.stop)
            spot = np.append(path[span].mean(0)[[0, 2]], self.toe_height)[[0, 2, 1]]
            shift[span] = spot - path[span]
            is_held[span] = True
        path = path + _faded(shift, is_held, fade)
        path[:, 1] = _soft_floor(path[:, 1] + _lifts(found, path, self.toe_height, fps), self.toe_height)
        return foot, path - carried

    def bring(self, rotations: _Array, pose: Pose, goal: tuple[_Array, _Array]) -> _Array:
        """Local rotations with this leg bent so that ankle and foot reach the goal."""
        foot, ankle = goal
        return bend_limb(
            self.limb, rotations, pose, hinge=pose.rotations[:, self.knee][:, :, 0], target=ankle, end=foot
        )


def _level_mean(foot: _Array) -> _Array:
    """The upright rotation with the mean heading of a foot."""
    ahead = foot[:, :, 2].mean(0)
    return matrix_from_axis_angle(np.array([0, np.arctan2(ahead[0], ahead[2]), 0]))


def _lowering(legs: list[_Leg], goals: list[tuple[_Array, _Array]], places: _Array, fps: float) -> _Array:
    """How far the hips must be lowered (t, 3) for both legs to reach their ankles, smoothed."""
    need = np.zeros(len(places))
    for leg, (_, ankle) in zip(legs, goals, strict=True):
        gap = ankle - places[:, leg.hip]
        flat = np.linalg.norm(gap[:, [0, 2]], axis=1)
        depth = np.sqrt(np.maximum((REACH * leg.length * 0.998) ** 2 - flat**2, 0.0))
        need = np.maximum(need, -gap[:, 1] - depth)
    half = max(1, round(0.2 * fps))
    return np.outer(_smooth(windows(need, half).max(-1), half), [0, 1, 0])


def _lifts(found: list[Stance], path: _Array, floor: float, fps: float) -> _Array:
    """Height added between two stances in different places if the foot hardly left the floor: a step."""
    lift = np.zeros(len(path))
    for before, after in zip(found, found[1:], strict=False):
        gap = slice(before.stop, after.start)
        missing = STEP_HEIGHT_M - float(path[gap, 1].max() - floor)
        travel = np.linalg.norm((path[after.start] - path[before.stop - 1])[[0, 2]])
        if missing > 0 and travel > 0.01 and after.start - before.stop <= LONGEST_STEP_SECONDS * fps:
            share = np.arange(1, after.start - before.stop + 1) / (after.start - before.stop + 1)
            lift[gap] = missing * np.sin(np.pi * share) ** 2
    return lift


def _soft_floor(height: _Array, floor: float) -> _Array:
    """Heights kept above the floor without a kink, at most 3 mm below it."""
    over = height - floor
    return floor + (over + np.hypot(over, SOFT_FLOOR_M) - SOFT_FLOOR_M) / 2


def _faded(change: _Array, is_held: NDArray[np.bool_], fade: int) -> _Array:
    """The change of held frames, blended smoothly between them, and faded to zero far from any."""
    held = np.flatnonzero(is_held)
    if not held.size:
        return np.zeros_like(change)
    t = np.arange(len(change))
    after = np.searchsorted(held, t)
    right, left = held[np.minimum(after, held.size - 1)], held[np.maximum(after - 1, 0)]
    to_left, to_right = np.abs(t - left), np.abs(right - t)
    weight_left, weight_right = (smootherstep(np.clip(1 - gap / fade, 0, 1)) for gap in (to_left, to_right))
    total = np.maximum(weight_left + weight_right, 1.0)[:, None]
    blend: _Array = (weight_left[:, None] * change[left] + weight_right[:, None] * change[right]) / total
    return np.where(is_held[:, None], change, blend)


def _smooth(values: _Array, half: int) -> _Array:
    """Mean over a Hann window of 2 half + 1 frames along time."""
    return weighted_mean(values, np.hanning(2 * half + 3)[1:-1])
