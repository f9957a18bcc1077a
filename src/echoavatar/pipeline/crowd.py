"""Free sessions by the dozen: all stages in one compiled loop that goes from session to session.

Stage by stage a batch leaves the processor's cache between stages, and the interpreter, whose own data the batch has
driven out, costs the more the more it is asked. Here a few sessions at a time go through all stages, and Python is left
once. The stages are the same functions, so the numbers are the same to the bit. It is compiled when the first large
batch comes. A second thread gains nothing: it wakes up later than one is done.
"""

import numpy as np
from jaxtyping import Bool, Float

from ..ik import HandGuard
from ..ik.chains import Chains, stand
from ..ik.clearing import keep_off
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import exact, scratch
from .calm import Calm, CalmState, smooth
from .feet import LARGEST, Feet, FeetState, lock
from .ground import Ground, GroundState, travel
from .motion_chunk import MotionBatch
from .pose import Array
from .unpack import Unpacking, pack, unpack

MANY = 16  # sessions from which on it pays
TOGETHER = 4  # sessions that stay in the cache


class Crowd:
    """The stages of a rig whose feet and arms are known, none left out, for rows without options."""

    def __init__(
        self, unpacking: Unpacking, chains: Chains, calm: Calm, ground: Ground, feet: Feet, hands: HandGuard
    ) -> None:
        self._calm = calm
        self._tables = (
            (unpacking.first, unpacking.joints, unpacking.travel),
            (chains.columns, chains.parents, chains.offsets),
            (ground.slots, ground.rest),
            (feet.legs, feet.standing),
            hands.tables,
        )

    def step(
        self,
        features: Float[Array, "b t c"],
        fps: float,
        options: Float[Array, "b o"],
        states: tuple[CalmState, GroundState, FeetState],
        active: Bool[Array, " b"],
    ) -> tuple[MotionBatch, int]:
        """Motion of a chunk, and how many rows of it are done.

        The next one has options that are not zero, or cannot be used without repair.
        """
        calm, ground, feet = states
        memory = calm.shown.numpy(), calm.travel.numpy(), ground.memory.numpy(), feet.memory.numpy()
        rows, frames = features.shape[:2]
        rotations = np.empty((rows, frames, memory[0].shape[1], 4), np.float32)
        root = np.empty((rows, frames, 3), np.float32)
        numbers = self._calm.numbers(frames, fps)
        done = _through(self._tables, numbers, F(fps), options, memory, features, active, rotations, root)
        return MotionBatch(rotations, root), int(done)


@exact()
def _through(tables, calm, fps, options, memory, features, active, rotations, places):  # type: ignore[no-untyped-def]
    """Free rows, `TOGETHER` at a time, up to the first that holds what cannot be used; how many rows were done."""
    (places_of, joints, column), (columns, parents, offsets), (slots, rest), (legs, standing), hands = tables
    shown, travels, grounded, held = memory
    rows, count = features.shape[0], features.shape[1]
    for row in range(rows - 1, -1, -1):
        for option in range(options.shape[1]):
            if options[row, option] != ZERO:
                rows = row
    all_frames = scratch((TOGETHER, columns.shape[0], 12, 8))
    all_turns, all_roots = scratch((TOGETHER, shown.shape[1], 4, 8)), scratch((TOGETHER, 3, 8))
    largest = scratch((TOGETHER,))
    for row in range(TOGETHER):
        largest[row] = F(LARGEST)
    for first in range(0, rows, TOGETHER):
        last = min(first + TOGETHER, rows)
        turns, roots = all_turns[: last - first], all_roots[: last - first]
        frames, on = all_frames[: last - first], active[first:last]
        if joints.shape[0] < turns.shape[1]:
            turns[...] = ZERO
            turns[:, :, 0] = ONE
        if not unpack(features[first:last], places_of, joints, column, turns, roots):
            return first
        smooth(turns, roots, count, shown[first:last], travels[first:last], on, calm[0], calm[1])
        stand(turns, columns, parents, offsets, frames)
        travel(slots, rest, frames, turns, roots, count, grounded[first:last], on)
        lock(legs, standing, frames, turns, roots, roots, count, fps, largest, held[first:last], on)
        keep_off(hands, frames, turns)
        pack(turns, roots, rotations[first:last], places[first:last])
    return rows
