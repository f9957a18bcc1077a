"""Detect planted feet, and measure how much they slide.

A foot is planted if its joint is near its standing height and has a low VERTICAL speed. Horizontal speed plays no part:
otherwise a sliding foot would pass for a swinging one.
"""

import numpy as np
from numpy.typing import NDArray

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


def skate(
    positions: NDArray[np.floating], fps: float, *, standing_height: NDArray[np.floating] | float | None = None
) -> float:
    """Mean horizontal speed of planted feet, centimetres per second; 0 if no foot is ever planted.

    The mean is over all pairs of neighbouring frames in which a foot is planted both times. One still foot and one
    sliding foot give half the sliding foot's speed.
    """
    place = np.asarray(positions, np.float64)
    is_planted = planted(place, fps, standing_height=standing_height)
    stays = is_planted[1:] & is_planted[:-1]
    if not stays.any():
        return 0.0
    speed = np.linalg.norm(np.diff(place[..., [0, 2]], axis=0), axis=-1) * fps
    return float(speed[stays].mean() * 100)
