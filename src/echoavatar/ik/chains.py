"""World poses of the few joints that the live stages look at: spine, neck, head, arms, fingers, legs.

Eight frames of a session at once (`nn.octet`): turns are (b, j, 4, 8), frames (b, c, 12, 8), the twelve numbers being
the rows of a rotation with the place as fourth column.
"""

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton
from ..kinematics.octets import matrix, quaternion_at
from ..nn.compiled import ONE, ZERO
from ..nn.octet import exact, fused, load, spread, store

Array = np.ndarray


class Chains:
    """Forward kinematics of a set of joints and everything between them and the root, in the root's frame."""

    def __init__(self, skeleton: Skeleton, wanted: list[int]) -> None:
        above: set[int] = set()
        for joint in wanted:
            while joint >= 0:
                above.add(joint)
                joint = skeleton.parents[joint]
        self.joints = [joint for level in skeleton.levels for joint in level if joint in above]
        self.slot = {joint: slot for slot, joint in enumerate(self.joints)}
        self.columns = np.array(self.joints, np.int64)
        parents = [self.slot.get(skeleton.parents[joint], 0) for joint in self.joints]
        self.parents = np.array(parents, np.int64)
        self.offsets = np.ascontiguousarray(skeleton.offsets.numpy()[self.joints], np.float32)

    def world(self, turns: Float[Array, "b j 4 8"]) -> Float[Array, "b c 12 8"]:
        """Frames relative to the root, which itself stands at the origin and is not turned."""
        frames = np.empty((len(turns), len(self.joints), 12, 8), np.float32)
        stand(turns, self.columns, self.parents, self.offsets, frames)
        return frames


@exact()
def stand(turns, joints, parents, offsets, frames):  # type: ignore[no-untyped-def]
    """The root comes first, every joint after its parent."""
    for row in range(turns.shape[0]):
        for number in range(12):
            store(
                frames, (row, 0, number), spread(ONE if number % 5 == 0 else ZERO, load(turns, (row, 0, 0)))
            )
        for slot in range(1, joints.shape[0]):
            parent, x, y, z = parents[slot], offsets[slot, 0], offsets[slot, 1], offsets[slot, 2]
            m = matrix(quaternion_at(turns, row, joints[slot]))
            for at in range(0, 12, 4):
                a, b = load(frames, (row, parent, at)), load(frames, (row, parent, at + 1))
                c, d = load(frames, (row, parent, at + 2)), load(frames, (row, parent, at + 3))
                store(frames, (row, slot, at), fused(c, m[6], fused(b, m[3], a * m[0])))
                store(frames, (row, slot, at + 1), fused(c, m[7], fused(b, m[4], a * m[1])))
                store(frames, (row, slot, at + 2), fused(c, m[8], fused(b, m[5], a * m[2])))
                store(frames, (row, slot, at + 3), fused(c, z, fused(b, y, fused(a, x, d))))
