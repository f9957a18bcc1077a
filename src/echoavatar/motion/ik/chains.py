"""Forward kinematics in a compiled loop, for the few joints that the live stages need, in the root's frame."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.quaternions import (
    IDENTITY,
    multiply,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    write_quaternion,
    write_vector,
)

Array = np.ndarray


class ChainPose(NamedTuple):
    """Joints in the root's frame: the root is at the origin, without rotation."""

    rotations: Float[Array, "b t c 4"]
    places: Float[Array, "b t c 3"]  # metres


class Chains:
    """The wanted joints and all joints between them and the root."""

    def __init__(self, skeleton: Skeleton, wanted: list[int]) -> None:
        above: set[int] = set()
        for joint in wanted:
            while joint >= 0:
                above.add(joint)
                joint = skeleton.parents[joint]
        self.joints = [joint for level in skeleton.levels for joint in level if joint in above]
        self.slot = {joint: slot for slot, joint in enumerate(self.joints)}
        self._joints = np.array(self.joints, np.int64)
        self._parents = np.array([self.slot.get(skeleton.parents[joint], 0) for joint in self.joints])
        self._offsets = np.ascontiguousarray(skeleton.offsets.numpy()[self.joints], np.float32)

    def pose(self, rotations: Float[Array, "b t j 4"]) -> ChainPose:
        """The pose of the joints from parent-relative rotations."""
        shape = (*rotations.shape[:2], len(self.joints))
        pose = ChainPose(np.empty((*shape, 4), np.float32), np.empty((*shape, 3), np.float32))
        descend(rotations, self._joints, self._parents, self._offsets, pose)
        return pose


@kernel()
def descend(rotations, joints, parents, offsets, pose):  # type: ignore[no-untyped-def]
    """Fill `pose`; the root comes first, and every joint after its parent."""
    for row in range(rotations.shape[0]):
        for frame in range(rotations.shape[1]):
            world, places = pose.rotations[row, frame], pose.places[row, frame]
            write_quaternion(world[0], IDENTITY)
            write_vector(places[0], (0.0, 0.0, 0.0))
            for slot in range(1, len(joints)):
                above = read_quaternion(world[parents[slot]])
                bone = rotate(above, read_vector(offsets[slot]))
                write_vector(places[slot], plus(read_vector(places[parents[slot]]), bone))
                own = read_quaternion(rotations[row, frame, joints[slot]])
                write_quaternion(world[slot], multiply(above, own))
