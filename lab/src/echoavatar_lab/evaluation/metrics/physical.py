"""Physical plausibility of motion: jerk, floor penetration, and EDGE's foot contact score.

Sliding feet are measured by `kinematics.contact.skate`, hands inside the body by `ik.measure`. Names carry the units.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

SMPL_FEET = (7, 10, 8, 11)
"""Left ankle and toe, right ankle and toe among SMPL's 24 joints."""
EDGE_SCALE = 10_000.0


def jerk_m_s3(positions: Float[np.ndarray, "t j 3"], fps: float = FRAME_RATE_HZ) -> float:
    """Mean length of the third derivative of joint positions relative to the root; NaN below four frames."""
    if len(positions) < 4:
        return float("nan")
    relative = positions - positions[:, :1]
    return float(np.linalg.norm(np.diff(relative, n=3, axis=0), axis=-1).mean() * fps**3)


def floor_depth_cm(feet: Float[np.ndarray, "t f 3"], floor_m: float = 0.0) -> float:
    """Mean depth of the lowest foot point below the floor (Y up), centimetres; 0 in frames where it is above."""
    return float(np.maximum(floor_m - feet[..., 1].min(1), 0).mean() * 100)


def foot_contact_score(
    positions: Float[np.ndarray, "t j 3"], feet: Sequence[int] = SMPL_FEET, *, up: int = 1, fps: float = FRAME_RATE_HZ
) -> float:
    """EDGE's physical foot contact score (PFC), times 10,000 as in its table; 0 is best.

    The root can only accelerate when a foot stands. The score is the mean over frames of the root's acceleration
    (downward part left out, scaled by the clip's maximum) times the horizontal step of each foot's stiller point.
    Known faults: it has no physical unit, one jolt rescales the whole clip, and a body that floats motionless scores 0.
    EDGE has Z up at 30 fps: `up=2`.
    """
    positions = np.asarray(positions, np.float64)
    acceleration = np.diff(positions[:, 0], n=2, axis=0) * fps**2
    acceleration[:, up] = np.maximum(acceleration[:, up], 0)
    push = np.linalg.norm(acceleration, axis=-1)
    flat = [axis for axis in range(3) if axis != up]
    steps = np.linalg.norm(np.diff(positions[1:, list(feet)][..., flat], axis=0), axis=-1)
    stiller = steps.reshape(len(steps), 2, 2).min(-1)
    return float((stiller.prod(1) * push / max(push.max(), 1e-12)).mean() * EDGE_SCALE)
