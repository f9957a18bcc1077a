"""What a user may ask of finished motion: stay on the spot, or move the upper body only."""

from dataclasses import replace

import numpy as np

from ..kinematics import Motion


def in_place(motion: Motion) -> Motion:
    """Root motion removed: the hips stay over the start, as game engines expect of in-place clips.

    Height is kept. Feet that step then slide under the body, as on a treadmill.
    """
    root = motion.root.copy()
    root[:, [0, 2]] = root[0, [0, 2]]
    return replace(motion, root=root)


def upper_body(motion: Motion) -> Motion:
    """Hips and legs stand still in the rest pose; everything above moves as it was."""
    skeleton = motion.skeleton
    rotations, root = motion.rotations.copy(), motion.root.copy()
    rotations[:, list(skeleton.config.parts["lower"])] = np.array([1, 0, 0, 0], np.float32)
    root[:] = skeleton.rest_positions[0].numpy()
    return replace(motion, rotations=rotations, root=root)
