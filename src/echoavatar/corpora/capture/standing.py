"""The body beneath gestures, in silence and while listening: captured people who stand, shift their weight and look.

Without a library a body made by rule stands in (`rehearsal.idle`).
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from echoavatar.corpora.rehearsal.controls import Controls, neutral

from .library import CapturedLibrary
from .motion_graph import ARMS, MotionGraph, walk

IDLE, TALKING = 0.25, 1.0  # liveliness


def standing(
    library: CapturedLibrary,
    frames: int,
    rng: np.random.Generator,
    *,
    liveliness: float | Float[np.ndarray, " t"] = IDLE,
    has_arms: bool = True,
) -> Controls:
    """A body that stands near the origin and mostly faces +Z; deterministic for the state of `rng`.

    Args:
        library: captured clips; kinds standing, speech and gesture are used.
        frames: how many.
        rng: draws clips, stretches, mirror images and sizes.
        liveliness: of sway, lean, turns and steps, for the whole or per frame: `IDLE` like people who wait, `TALKING`
            like people who talk.
        has_arms: False leaves the arms hanging, for gestures to be laid over.
    """
    wanted = np.broadcast_to(np.asarray(liveliness, np.float64), (frames,))
    body = walk(_graph(library, has_arms), wanted, rng)
    if not has_arms:
        body = replace(body, **{name: getattr(neutral(frames), name) for name in ARMS})
    return body


@lru_cache(maxsize=4)
def _graph(library: CapturedLibrary, has_arms: bool) -> MotionGraph:
    kinds = ("standing",) if has_arms else ("standing", "speech", "gesture")
    clips = [clip.controls for clip in library.of(*kinds) if clip.seconds > 4]  # type: ignore[arg-type]
    return MotionGraph(clips, has_arms=has_arms)
