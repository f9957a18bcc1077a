"""World poses of the few joints that keep hands off the body: spine, neck, head, arms, fingers.

Frames lie last in every array (3, 4, joints, frames), so that one session costs few numpy calls and many cost plain
loops over memory; measured against batched products of torch this is three times faster from 1 to 64 sessions.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..kinematics import Skeleton, lanes

Array = np.ndarray
_ROOT = np.eye(3, 4, dtype=np.float32)[..., None]


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
        self._columns = np.array(self.joints)
        self._offsets = skeleton.offsets.numpy()[self.joints].T[:, :, None].astype(np.float32)
        sizes = [sum(joint in above for joint in level) for level in skeleton.levels]
        ends = np.cumsum(sizes)
        self._levels: list[tuple[slice, slice | Int[Array, " l"]]] = []
        for first, last in zip(ends, ends[1:], strict=False):
            level = slice(int(first), int(last))
            if last > first:
                parents = [self.slot[skeleton.parents[joint]] for joint in self.joints[level]]
                self._levels.append((level, _as_slice(parents)))

    def local(self, rotations: Float[Array, "n j 3 3"]) -> Float[Array, "4 4 c n"]:
        """Local frames: rotation, the rest offset as the fourth column, and 0 0 0 1 below."""
        frames = np.empty((4, 4, len(self.joints), len(rotations)), np.float32)
        frames[:3, :3] = rotations.transpose(2, 3, 1, 0)[:, :, self._columns]
        frames[:3, 3] = self._offsets
        frames[3, :3], frames[3, 3] = 0, 1
        return frames

    def local_of(self, turns: Float[Array, "4 j n"]) -> Float[Array, "4 4 c n"]:
        """The same local frames from quaternions of all joints of the rig."""
        frames = np.empty((4, 4, len(self.joints), turns.shape[-1]), np.float32)
        lanes.matrix(turns[:, self._columns], out=frames[:3, :3])
        frames[:3, 3] = self._offsets
        frames[3, :3], frames[3, 3] = 0, 1
        return frames

    def world(self, local: Float[Array, "4 4 c n"]) -> Float[Array, "3 4 c n"]:
        """Frames relative to the root, which itself stands at the origin and is not turned."""
        frames = np.empty((3, *local.shape[1:]), np.float32)
        frames[:, :, 0] = _ROOT
        if self._levels:
            frames[:, :, self._levels[0][0]] = local[:3, :, self._levels[0][0]]
        for level, parents in self._levels[1:]:
            np.einsum("ijcn,jkcn->ikcn", frames[:, :, parents], local[:, :, level], out=frames[:, :, level])
        return frames


def _as_slice(slots: list[int]) -> slice | Int[Array, " l"]:
    """A slice where one says the same: neighbours in order, or one joint for all (by broadcasting)."""
    if slots == list(range(slots[0], slots[0] + len(slots))):
        return slice(slots[0], slots[-1] + 1)
    if len(set(slots)) == 1:
        return slice(slots[0], slots[0] + 1)
    return np.array(slots)


class Points(NamedTuple):
    """Points that are fixed to joints."""

    slots: Int[Array, " p"]
    offsets: Float[Array, "3 p"]  # metres, in the joint's frame

    def place(self, frames: Float[Array, "3 4 c n"]) -> Float[Array, "3 p n"]:
        """Where they are."""
        carriers = frames[:, :, self.slots]
        placed: Array = np.einsum("ijpn,jp->ipn", carriers[:, :3], self.offsets)
        placed += carriers[:, 3]
        return placed
