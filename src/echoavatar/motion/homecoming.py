"""The way home: a body that has danced away steps back to where the session began, while nothing else moves it.

Not in the paper. The generator does not know where the body stands, so a dance of a minute ends metres away. The body
is shown shifted over the floor by an offset, which changes in steps only: one foot stands, the other is lifted and set
down, and the hips follow. The body keeps its heading, so it is ready for the next sound at any time. When sound comes,
the foot in the air lands, the other joins it, and the offset stays until the next pause.
"""

import math
from typing import NamedTuple

import numpy as np

from echoavatar.nn.kernels import kernel
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

from .ik.limbs import Chains, Legs, bend, legs_of
from .kinematics import Motion, Skeleton
from .kinematics.easing import smoothstep
from .kinematics.quaternions import minus, plus, read_quaternion, read_vector, rotate_back, write_vector
from .motion_chunk import KEPT, MotionChunk
from .stages.modes import FREE, MotionOptions

WAIT_S = 2.5  # of rest before the first step
FAR, HOME = 0.3, 0.02  # metres from home from which the body walks, and at which it has arrived
STILL = 0.02  # of a quaternion of the legs, in a chunk: about 9 degrees a second
CLOSE = 2e-4  # metres between the offsets of hips and feet at which the walk is over
STEP_S = 0.44  # from one landing to the next
STRIDE, SIDESTEP = 0.3, 0.22  # metres: the longest step ahead or back, and to a side
LIFT = 0.05  # metres: height of a stepping foot
AWAY, LANDS = 0.15, 0.9  # shares of a step between which the foot travels
DIP = 0.035  # metres by which walking hips are lower, so that both legs reach the floor
SWAY = 0.03  # metres by which the hips go over the foot that stands
FOLLOW = 7.0  # per second: how quickly the hips follow


class _Way(NamedTuple):
    """The offsets of feet and hips, metres along x and z (hips: x, y, z), and the step in progress."""

    goal: tuple[float, float] | None = None  # the offset to walk to; None: no walk in progress
    feet: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))  # left, right; as planted
    hips: tuple[float, ...] = (0.0, 0.0, 0.0)
    speed: tuple[float, ...] = (0.0, 0.0, 0.0)  # of the hips, metres per second
    side: int = -1  # of the stepping foot: 0 left, 1 right, -1 none
    last: int = 1  # the foot that stepped last
    land: tuple[float, float] = (0.0, 0.0)  # where it lands
    frame: int = 0  # of the step
    rested: float = 0.0  # seconds

    @property
    def is_over(self) -> bool:
        """Whether hips and feet have the same offset, and no foot is in the air."""
        left, right = self.feet
        x, y, z = (part - there for part, there in zip(self.hips, (left[0], 0.0, left[1]), strict=True))
        return self.side < 0 and left == right and x * x + y * y + z * z < CLOSE * CLOSE


class Homecoming:
    """The way home of one session."""

    def __init__(self, skeleton: Skeleton, options: MotionOptions = FREE, chunk: ChunkSize = CHUNK) -> None:
        has_place = options.in_place or options.upper_body or options.leash_m > 0
        self._chains = Chains(skeleton, list(skeleton.config.feet))
        self._legs = None if has_place else legs_of(skeleton, self._chains)
        self._seconds = chunk.frames / FRAME_RATE_HZ
        self._ways: dict[int, _Way] = {}  # after each chunk, so that a chunk that is made again is the same

    def apply(self, chunk: int, motion: MotionChunk, *, is_idle: bool) -> MotionChunk:
        """The chunk with its offset; `is_idle` says that nothing else moves the body."""
        if self._legs is None:
            return motion
        way = self._ways.get(chunk - 1, _Way())
        way = way._replace(rested=way.rested + self._seconds if is_idle else 0.0)
        x, z = (float(value) for value in motion.root[-1, [0, 2]])
        if not is_idle:
            way = way._replace(goal=None)
        elif way.is_over and way.rested > WAIT_S and math.hypot(x + way.feet[0][0], z + way.feet[0][1]) > FAR:
            way = way._replace(goal=(-x, -z) if _stands(motion, self._legs) else None)
        if not way.is_over or way.goal is not None:
            motion, way = self._walk(motion, way, self._legs)
        elif way.feet[0] != (0.0, 0.0):
            root = motion.root + np.array([way.feet[0][0], 0, way.feet[0][1]], motion.root.dtype)
            motion = motion._replace(root=root)
        self._ways[chunk] = way
        self._ways.pop(chunk - KEPT, None)
        return motion

    def _walk(self, motion: MotionChunk, way: _Way, legs: Legs) -> tuple[MotionChunk, _Way]:
        """Step on through a chunk."""
        rotations, root = motion.rotations.astype(np.float32), motion.root.astype(np.float32)
        hips, feet = np.zeros((len(root), 3)), np.zeros((len(root), 2, 3))
        for frame in range(len(root)):
            w, x, y, z = (float(part) for part in rotations[frame, 0])
            ahead = (2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
            way = _step(way, (ahead[0] / math.hypot(*ahead), ahead[1] / math.hypot(*ahead)))
            hips[frame], feet[frame, :, ::2] = way.hips, way.feet
            if way.side >= 0:
                feet[frame, way.side] = _in_the_air(way)
        pose = self._chains.pose(rotations[None])
        carry(legs, pose.rotations[0], pose.places[0], rotations, root, hips, feet)
        return motion._replace(rotations=rotations, root=root.astype(motion.root.dtype)), way


def _stands(motion: MotionChunk, legs: Legs) -> bool:
    """Whether the legs have nearly the same pose at both ends of a chunk."""
    first, last = motion.rotations[[0, -1]][:, legs.joints.ravel()]
    return bool((1 - np.abs((first * last).sum(-1)) < STILL * STILL / 2).all())


def _step(way: _Way, ahead: tuple[float, float]) -> _Way:
    """The next frame; `ahead` is the body's direction along x and z, of length 1."""
    way = way._replace(frame=way.frame + 1)
    if way.side >= 0 and way.frame > STEP_S * FRAME_RATE_HZ:  # it has landed
        feet = (way.land, way.feet[1]) if way.side == 0 else (way.feet[0], way.land)
        way = way._replace(feet=feet, last=way.side, side=-1)
    if way.side < 0:
        way = _next_step(way, ahead)
    stands = way.feet if way.side < 0 else (way.feet[1 - way.side], way.land)
    is_on = way.side >= 0
    sway = SWAY * (way.side * 2 - 1) * is_on  # to the left while the right foot steps; left is (ahead z, -ahead x)
    wanted = (
        (stands[0][0] + stands[1][0]) / 2 + sway * ahead[1],
        -DIP * is_on,
        (stands[0][1] + stands[1][1]) / 2 - sway * ahead[0],
    )
    hips, speed = list(way.hips), list(way.speed)
    for axis in range(3):  # a spring without overshoot
        speed[axis] += (FOLLOW * FOLLOW * (wanted[axis] - hips[axis]) - 2 * FOLLOW * speed[axis]) / FRAME_RATE_HZ
        hips[axis] += speed[axis] / FRAME_RATE_HZ
    return way._replace(hips=tuple(hips), speed=tuple(speed))


def _next_step(way: _Way, ahead: tuple[float, float]) -> _Way:
    """Lift the other foot, if there is a way to go or the feet are apart."""
    side = 1 - way.last
    other, own = way.feet[way.last], way.feet[side]
    goal = other if way.goal is None else way.goal
    gap = (goal[0] - other[0], goal[1] - other[1])
    along, aside = gap[0] * ahead[0] + gap[1] * ahead[1], gap[0] * ahead[1] - gap[1] * ahead[0]
    if math.hypot(*gap) < HOME:
        return way._replace(goal=None) if own == other else way._replace(side=side, land=other, frame=0)
    along /= max(1, math.ceil(abs(along) / STRIDE))
    # Feet never cross: the foot on the side of the way goes there, the other joins it.
    aside = aside / max(1, math.ceil(abs(aside) / SIDESTEP)) if (aside > 0) == (side == 0) else 0.0
    land = (other[0] + along * ahead[0] + aside * ahead[1], other[1] + along * ahead[1] - aside * ahead[0])
    return way._replace(side=side, land=land, frame=0)


def _in_the_air(way: _Way) -> tuple[float, float, float]:
    """The offset of the stepping foot, metres: it rises before it travels, and travels before it lands."""
    share = way.frame / (STEP_S * FRAME_RATE_HZ)
    gone = float(smoothstep((share - AWAY) / (LANDS - AWAY)))
    (x, z), (to_x, to_z) = way.feet[way.side], way.land
    return x + (to_x - x) * gone, LIFT * math.sin(math.pi * min(share, 1.0)), z + (to_z - z) * gone


@kernel()
def carry(legs, world, places, rotations, root, hips, feet):  # type: ignore[no-untyped-def]
    """Move the hips and each foot of every frame by its offset; `world` and `places` are the legs' chains."""
    for frame in range(rotations.shape[0]):
        turn, way = read_quaternion(rotations[frame, 0]), read_vector(hips[frame])
        for side in range(2):
            aside = rotate_back(turn, minus(read_vector(feet[frame, side]), way))
            bend(legs, side, rotations[frame], world[frame], places[frame], aside)
        write_vector(root[frame], plus(read_vector(root[frame]), way))


def warm_up(skeleton: Skeleton) -> None:
    """Compile the loop; the result is cached on disk."""
    rest = Motion.at_rest(skeleton)
    if (legs := legs_of(skeleton)) is not None:
        Homecoming(skeleton)._walk(MotionChunk(rest.rotations, rest.root), _Way(), legs)
