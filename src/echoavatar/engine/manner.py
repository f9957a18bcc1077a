"""The manner of a session's speaker: drawn from the seed, drifting slowly, with parts that a user sets.

A number that is set holds from the next chunk on. The others wander around what was drawn, so that a long talk does not
look the same from minute to minute. All follows from the seed, the requests and the chunk.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.models.generator.manner import MANNER, draw_manner
from echoavatar.motion.stages.modes import MotionOptions

TOLD = {"liveliness": "liveliness", "handedness": "right"}  # what users set, by its name in `Manner`
LIVELINESS = MANNER.index("liveliness")
DRIFT = 0.15  # how far a number wanders from what was drawn
DRIFT_CHUNKS = 45  # 12 s, two or three phrases, until it stands elsewhere


class SpeakerManner:
    """The manner of one session, chunk by chunk."""

    def __init__(self, seed: int, options: MotionOptions) -> None:
        self._seed, self._drawn = seed, np.array(draw_manner(seed).values)
        self._set: dict[str, float] = {}
        self.choose(options.liveliness, options.handedness)

    def choose(self, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Set numbers between 0 and 1; what is None stays as it is. See `MotionOptions`."""
        told = {"liveliness": liveliness, "handedness": handedness}
        self._set |= {TOLD[name]: value for name, value in told.items() if value is not None}

    def at(self, chunk: int) -> Float[np.ndarray, " m"]:
        """The numbers of a chunk, in the order of `MANNER`."""
        block, into = divmod(chunk, DRIFT_CHUNKS)
        before, after = self._wander(block), self._wander(block + 1)
        values: Float[np.ndarray, " m"] = np.clip(self._drawn + before + (after - before) * into / DRIFT_CHUNKS, 0, 1)
        for name, value in self._set.items():
            values[MANNER.index(name)] = value
        return values.astype(np.float32)

    def _wander(self, block: int) -> Float[np.ndarray, " m"]:
        wander = np.random.default_rng([self._seed, 2, block]).uniform(-DRIFT, DRIFT, len(MANNER))
        wander[MANNER.index("rest")] = 0  # where idle hands are is a habit
        return wander
