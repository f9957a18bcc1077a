"""The body beneath gestures and in silence: captured people who stand, shift their weight and look about.

Without a library a body made by rule stands in (`gesture.idle`).
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar_lab.corpora.controls import Controls

from .library import CapturedLibrary
from .motion_graph import MotionGraph, walk

IDLE, TALKING = 0.25, 1.0  # liveliness
SHORTEST_S = 4.0


def standing(
    library: CapturedLibrary, frames: int, rng: np.random.Generator, *, liveliness: float | Float[np.ndarray, " t"]
) -> Controls:
    """A body that stands near the origin and mostly faces +Z; deterministic for the state of `rng`.

    Args:
        library: captured clips; bodies that wait take kind standing, bodies that talk also speech and gesture.
        frames: how many.
        rng: draws clips, stretches, mirror images and sizes.
        liveliness: of sway, lean, turns and steps, for the whole or per frame: `IDLE` like people who wait, `TALKING`
            like people who talk. Arms are as captured; those of a lively body make gestures that fit no sound, so the
            caller lays others over them.

    Raises:
        MotionError: the library has nobody who stands.
    """
    wanted = np.broadcast_to(np.asarray(liveliness, np.float64), (frames,))
    return walk(_graph(library), wanted, rng)


@lru_cache(maxsize=2)
def _graph(library: CapturedLibrary) -> MotionGraph:
    clips = [clip for clip in library.of("standing", "speech", "gesture") if clip.seconds > SHORTEST_S]
    waiting = [clip.kind == "standing" for clip in clips]
    if not any(waiting):
        raise MotionError("the library has no clip of kind standing longer than 4 s; bodies need one")
    return MotionGraph([clip.controls for clip in clips], waiting)
