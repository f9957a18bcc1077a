"""Feet that stand still between steps: a foot moves over the floor only while it is lifted. Not in the paper.

Retargeting keeps planted feet still as far as the take allows. Here what is left (shuffles, low steps, feet that turn
on the floor) becomes steps of enough height, for bodies that talk or wait.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Array, Controls, minimum_jerk, smoothed, spans_of

UP_M, FAST_M_S, FAST_RAD_S = 0.015, 0.08, 0.6  # a foot higher or faster than this is on its way
SHORTEST_STANCE, SHORTEST_STEP = 4, 10  # frames
LONGEST_STEP = 24  # frames; a longer way becomes several steps
SAME_M, SAME_RAD = 0.012, 0.04  # stances nearer to each other than this are one


def stepping(controls: Controls) -> Controls:
    """The same performance with each foot still while it stands, and lifted wherever it moves."""
    place, yaw = controls.foot_position.copy(), controls.foot_yaw.copy()
    for side in range(2):
        place[:, side], yaw[:, side] = _stepped(place[:, side], yaw[:, side])
    return replace(controls, foot_position=place, foot_yaw=yaw)


def _stepped(place: Float[Array, "t 3"], yaw: Float[Array, " t"]) -> tuple[Array, Array]:
    path = np.concatenate([place, yaw[:, None]], 1).astype(np.float64)
    effort = _effort(place, yaw)
    moves = effort > 1
    for begin, end in spans_of(moves):
        for middle in _rests(effort[begin:end]) if end - begin > LONGEST_STEP else ():
            moves[begin + middle - SHORTEST_STANCE // 2 : begin + middle + SHORTEST_STANCE // 2] = False
    spans = _stances(moves)
    spots = [np.append(np.median(path[a:b], axis=0)[[0, 2]], np.median(path[a:b, 3])) for a, b in spans]
    for number in range(1, len(spans)):
        before, after = spots[number - 1], spots[number]
        if np.hypot(*(after - before)[:2]) < SAME_M and abs(after[2] - before[2]) < SAME_RAD:
            spots[number] = before
    out = path.copy()
    for (begin, end), spot in zip(spans, spots, strict=True):
        out[begin:end] = (spot[0], ANKLE_HEIGHT, spot[1], spot[2])
    for number in range(len(spans) + 1):
        begin = spans[number - 1][1] if number else 0
        end = spans[number][0] if number < len(spans) else len(path)
        if begin < end:
            out[begin:end] = _way(path, out, begin, end, has_start=number > 0, has_end=number < len(spans))
    return out[:, :3].astype(np.float32), out[:, 3].astype(np.float32)


def _effort(place: Float[Array, "t 3"], yaw: Float[Array, " t"]) -> Float[Array, " t"]:
    """How much a foot is on its way, above 1 where it is up, or moves or turns on the floor."""
    flat = smoothed(np.concatenate([place[:, [0, 2]], yaw[:, None]], 1), 0.05)
    speed = np.abs(np.gradient(flat, axis=0)) * FRAME_RATE_HZ
    up = (place[:, 1] - ANKLE_HEIGHT) / UP_M
    return np.asarray(np.max([up, np.hypot(*speed[:, :2].T) / FAST_M_S, speed[:, 2] / FAST_RAD_S], axis=0))


def _rests(effort: Float[Array, " t"]) -> list[int]:
    """Frames of a long way in which the foot is slowest and lowest, a step apart."""
    wanted, gap = max(2, round(len(effort) / LONGEST_STEP)), SHORTEST_STEP + SHORTEST_STANCE
    found: list[int] = []
    for frame in np.argsort(effort[gap:-gap]) + gap:
        if len(found) < wanted - 1 and all(abs(int(frame) - other) >= gap for other in found):
            found.append(int(frame))
    return found


def _stances(moves: Bool[Array, " t"]) -> list[tuple[int, int]]:
    """Frames in which the foot stands, with time for a step between any two stances."""
    padded = np.pad(moves, SHORTEST_STANCE, mode="edge")
    spans = spans_of(~binary_closing(padded, np.ones(SHORTEST_STANCE - 1))[SHORTEST_STANCE:-SHORTEST_STANCE])
    for number in range(1, len(spans)):
        (a, b), (c, d) = spans[number - 1], spans[number]
        missing = max(0, SHORTEST_STEP - (c - b))
        spans[number - 1], spans[number] = (a, b - missing // 2), (c + missing - missing // 2, d)
    return [(a, b) for a, b in spans if b - a >= SHORTEST_STANCE]


def _way(path: Array, out: Array, begin: int, end: int, *, has_start: bool, has_end: bool) -> Array:
    """The way between two stances: a step, or the captured path bent to the stances at its ends."""
    length = end - begin
    phase = (np.arange(length) + 1) / (length + 1)
    first = out[begin - 1] if has_start else path[begin]
    last = out[end] if has_end else path[end - 1]
    start = path[max(begin - 1, 0)] if has_start else path[begin]
    stop = path[min(end, len(path) - 1)] if has_end else path[end - 1]
    share = minimum_jerk((phase - 0.15) / 0.7)[:, None]
    own = path[begin:end] + (first - start) * (1 - share) + (last - stop) * share
    if not (has_start and has_end):
        return np.asarray(own)
    far = float(np.hypot(*(last - first)[[0, 2]])) + 0.1 * abs(float(last[3] - first[3]))
    if length <= LONGEST_STEP:
        height = np.maximum(own[:, 1], ANKLE_HEIGHT)
        own = first + (last - first) * share
        own[:, 1] = height
    if far > 1e-4:
        lift = min(0.025 + 0.2 * far, 0.06)
        own[:, 1] = np.maximum(own[:, 1], ANKLE_HEIGHT + lift * (4 * phase * (1 - phase)) ** 2)
    return np.asarray(own)
