"""Motion whose fingers close as the arm rises, which a model learns in seconds."""

import numpy as np

from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar_lab.models.fingers.model import FingerConfig
from echoavatar_lab.models.fingers.train import FingerTraining

TINY = FingerConfig(frames=16, patch=2, width=32, layers=1, heads=2, poses=4)
QUICK = FingerTraining(steps=6, batch=4, warmup=1, save_every=2, learning_rate=3e-3)


def waving(frames: int = 120, seed: int = 0, *, still: tuple[str, ...] = ()) -> Motion:
    """Both arms swing, each at its own pace; a hand closes as its arm rises, unless its side is in `still`."""
    rng = np.random.default_rng(seed)
    turns = np.zeros((frames, HUMANOID.joints, 3), np.float32)
    time = np.arange(frames) / 30
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rate, start = rng.uniform(0.3, 0.8), rng.uniform(0, 6)
        lift = np.sin(2 * np.pi * rate * time + start)
        turns[:, HUMANOID.index(f"{side}UpperArm"), 2] = sign * (0.6 * lift - 0.7)
        if side not in still:
            for digit in ("Index", "Middle", "Ring", "Little"):
                for bone in ("Proximal", "Intermediate", "Distal"):
                    turns[:, HUMANOID.index(f"{side}{digit}{bone}"), 2] = -sign * (0.5 + 0.4 * lift)
    root = np.tile(HUMANOID.rest_positions[0], (frames, 1))
    return Motion(HUMANOID, quaternion_from_axis_angle(turns), root, 30.0)


def without(motion: Motion, *words: str) -> Motion:
    """The motion on a rig without the joints whose names contain one of these words."""
    rig = motion.skeleton
    kept = [i for i, name in enumerate(rig.names) if not any(word in name for word in words)]
    config = rig.config.model_copy(
        update={
            "names": tuple(rig.names[i] for i in kept),
            "parents": tuple(kept.index(rig.parents[i]) if i else -1 for i in kept),
            "offsets": tuple(rig.config.offsets[i] for i in kept),
            "parts": {},
            "mirror": (),
            "feet": (),
            "tips": {},
            "vrm": {rig.names[i]: row for row, i in enumerate(kept)},
        }
    )
    return Motion(Skeleton(config), motion.rotations[:, kept], motion.root, motion.fps)
