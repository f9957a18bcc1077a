"""Root travel from planted feet: the root moves so that the planted foot stays where it is.

The decoded root velocity carries the tokenizer's quantisation error, which shows as sliding feet. While a foot is
planted, the legs tell how the pelvis moves over it, and that movement is integrated. As the feet leave the floor, or
travel faster than an error makes them slide (a dancer's low step, a pivot), the decoded velocity takes over. Not in
the paper; its foot losses (appendix) act in training only.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..ik.limbs import ChainPose, Chains
from ..kinematics import Skeleton
from ..kinematics.easing import smoothstep
from ..kinematics.quaternions import read_quaternion, read_vector, rotate, write_vector
from .feet import STANDING_SPEED, STEPPING_SPEED
from .pose import Array, Pose

RELEASE_HEIGHT = 0.035  # metres above its rest height from which a point does not count as planted


@dataclass
class GroundState(StreamState):
    """The root's position, and the feet in the last frame."""

    seen: Bool[Array, " b"]
    place: Float[Array, "b 2"]  # metres along x and z
    points: Float[Array, "b p 3"]  # ankles and toes: x and z relative to the root, and how firmly planted, 0 to 1


class Ground:
    """Integrates the root over planted feet. A rig whose feet are not known travels as decoded."""

    def __init__(self, skeleton: Skeleton, chains: Chains, *, is_holding: bool = True) -> None:
        """`chains` must hold `skeleton.config.feet`. Without `is_holding` the root travels as decoded."""
        feet = list(skeleton.config.feet) if is_holding else []
        self._slots = np.array([chains.slot[joint] for joint in feet], np.int64)
        self._rest = skeleton.rest_positions[feet, 1]  # the sole is at 0

    def init_state(self, rows: int) -> GroundState:
        """Standing at the origin, nothing seen yet."""
        points = np.zeros((rows, len(self._slots), 3), np.float32)
        return GroundState(np.zeros(rows, np.bool_), np.zeros((rows, 2), np.float32), points)

    def step(self, pose: Pose, chains: ChainPose, state: GroundState, active: Bool[Array, " b"]) -> None:
        """Replace the decoded travel in `pose.root` by world positions; `chains` is the pose's."""
        memory = state.seen, state.place, state.points
        travel(self._slots, self._rest, chains, pose.rotations, pose.root, memory, active, pose.fps)


@kernel()
def travel(slots, rest, chains, rotations, root, memory, active, fps):  # type: ignore[no-untyped-def]
    """Integrate the root of active rows from the movement of their ankles and toes relative to it, in world axes."""
    seen, places, all_points = memory
    for row in range(len(rotations)):
        if not active[row]:
            continue
        place, points = places[row], all_points[row]
        for frame in range(rotations.shape[1]):
            is_first = frame == 0 and not seen[row]
            hips, height = read_quaternion(rotations[row, frame, 0]), root[row, frame, 1]
            held_x = held_z = total = strongest = sinking = pressing = firmest = 0.0
            for point in range(len(slots)):
                x, y, z = rotate(hips, read_vector(chains.places[row, frame, slots[point]]))
                clearance = height + y - rest[point]
                weight = 1.0 - smoothstep(clearance / RELEASE_HEIGHT)
                if is_first:
                    write_vector(points[point], (x, z, weight))
                last_x, last_z, last_weight = read_vector(points[point])
                speed = fps * math.hypot(x - last_x + root[row, frame, 0], z - last_z + root[row, frame, 2])
                standing = 1.0 - smoothstep((speed - STANDING_SPEED) / (STEPPING_SPEED - STANDING_SPEED))
                both = min(weight, last_weight) * standing
                lead = both**4  # the more firmly planted point leads
                held_x, held_z = held_x + lead * (last_x - x), held_z + lead * (last_z - z)
                total, strongest = total + lead, max(strongest, both)
                sinking, pressing = sinking + weight**4 * clearance, pressing + weight**4
                firmest = max(firmest, weight)
                write_vector(points[point], (x, z, weight))
            if not is_first:
                x, z = root[row, frame, 0], root[row, frame, 2]
                place[0] += x + (held_x / max(total, 1e-6) - x) * strongest
                place[1] += z + (held_z / max(total, 1e-6) - z) * strongest
            height -= firmest * sinking / max(pressing, 1e-6)
            write_vector(root[row, frame], (place[0], height, place[1]))
        seen[row] = True
