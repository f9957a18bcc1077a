"""A leash that keeps the root near where it started, without sliding feet.

A character that dances for an hour must not leave the picture. Beyond `NEAR` of the leash's length the root is pulled
back. Beyond `EDGE` it is also slowed in its way outwards, and it never passes the end. Meanwhile `feet` holds planted
feet where they stand; they take their new place with the next step. The pull therefore weakens as a held foot gets
away from its decoded place, stops at `LEAN`, and resumes when the foot has stepped. Pinned rows (`in_place`) do not
move at all. Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..kinematics.easing import smoothstep
from .pose import Array, Pose

NEAR, EDGE = 0.4, 0.7  # of the leash's length: where the pull begins, and where the way outwards is slowed
PULL_SPEED = 0.25  # metres per second at the leash's end
LEAN = 0.05  # metres between a held foot and its decoded place at which the pull stops


@dataclass
class LeashState(StreamState):
    """The root in the last frame, along x and z."""

    seen: Bool[Array, " b"]
    decoded: Float[Array, "b 2"]  # metres, before the leash
    place: Float[Array, "b 2"]  # metres, after the leash
    pull: Float[Array, "b 2"]  # metres per frame
    slowness: Float[Array, " b"]  # share of outward movement that is removed


class Leash:
    """A soft bound on the root's distance from the origin, where a session starts."""

    def init_state(self, rows: int) -> LeashState:
        """The root stands where its session starts."""
        decoded, place, pull = (np.zeros((rows, 2), np.float32) for _ in range(3))
        return LeashState(np.zeros(rows, np.bool_), decoded, place, pull, np.zeros(rows, np.float32))

    def step(
        self,
        pose: Pose,
        state: LeashState,
        active: Bool[Array, " b"],
        *,
        radius: Float[Array, " b"],
        is_pinned: Bool[Array, " b"],
        lean: Float[Array, " b"],
    ) -> None:
        """Move `pose.root` in place. A radius of 0 is no leash; `lean` is the distance of `FeetState.lean`, metres."""
        memory, radii = tuple(vars(state).values()), np.ascontiguousarray(radius)
        chosen = active & ((radius > 0) | is_pinned)
        hold(pose.root, memory, chosen, radii, is_pinned, lean, PULL_SPEED / pose.fps)


@kernel()
def hold(root, memory, chosen, radii, is_pinned, lean, pull_speed):  # type: ignore[no-untyped-def]
    """Apply the leash to the chosen rows, frame by frame; `pull_speed` is in metres per frame."""
    seen, decoded, places, pulls, slowness = memory
    frames = root.shape[1]
    for row in range(len(root)):
        if not chosen[row]:
            continue
        if not seen[row]:
            decoded[row, 0], decoded[row, 1] = root[row, 0, 0], root[row, 0, 2]
            places[row, 0], places[row, 1] = root[row, 0, 0], root[row, 0, 2]
        seen[row] = True
        last_x, last_z, x, z = decoded[row, 0], decoded[row, 1], places[row, 0], places[row, 1]
        radius = radii[row] if radii[row] > 0.0 else math.inf
        far = math.hypot(x, z)
        out_x, out_z = x / max(far, 1e-6), z / max(far, 1e-6)
        rest = 1.0 - min(lean[row] / LEAN, 1.0) ** 2
        pull = smoothstep((far / radius - NEAR) / (1.0 - NEAR)) * rest * pull_speed
        slow = smoothstep((far / radius - EDGE) / (1.0 - EDGE))
        for frame in range(frames):
            share = (frame + 1) / frames
            way_x, way_z = root[row, frame, 0] - last_x, root[row, frame, 2] - last_z
            last_x, last_z = root[row, frame, 0], root[row, frame, 2]
            outwards = max(way_x * out_x + way_z * out_z, 0.0)
            outwards *= slowness[row] + share * (slow - slowness[row])
            x += way_x + pulls[row, 0] + share * (-out_x * pull - pulls[row, 0]) - out_x * outwards
            z += way_z + pulls[row, 1] + share * (-out_z * pull - pulls[row, 1]) - out_z * outwards
            if is_pinned[row]:
                x = z = 0.0
            beyond = max(math.hypot(x, z) / radius, 1.0)
            root[row, frame, 0], root[row, frame, 2] = x / beyond, z / beyond
        decoded[row, 0], decoded[row, 1] = last_x, last_z
        places[row, 0], places[row, 1] = root[row, frames - 1, 0], root[row, frames - 1, 2]
        pulls[row, 0], pulls[row, 1], slowness[row] = -out_x * pull, -out_z * pull, slow
