"""The manner of a session's speaker: drawn from the seed, drifting slowly, with parts that a user sets.

A number that is set holds from the next chunk on. The others wander around what was drawn, so that a long talk does not
look the same from minute to minute. Which hand works is decided for some seconds at a time, as the manner says: the
sound does not tell it, and a model that decides anew in each chunk moves both hands alike. All follows from the seed,
the requests and the chunk.
"""

import functools

import numpy as np
from jaxtyping import Float

from echoavatar.models.generator.manner import BUSY_S, MANNER, draw_manner
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.motion.stages.stillness import WHOLE
from echoavatar.timing import CHUNK, ChunkSize

SET = {"liveliness": "liveliness", "handedness": "right"}  # what users set, and its name in `Manner`
LIVELINESS, RIGHT, BOTH, REST = (MANNER.index(x) for x in ("liveliness", "right", "both", "rest"))
# Added to the drawn numbers, because the model exaggerates: it gestures more than it is told, uses both hands more
# often, and mirrors them less.
CORRECTED = {"liveliness": -0.05, "both": -0.1, "mirror": 0.3}
LIVELIEST = 0.85  # what the model is told for liveliness 1; it saw few livelier speakers
# Factors on the model's moves, at the points `SIZED` of `dial`. The stage `stillness` takes a tenth; calm speakers move
# less often rather than less far.
SMALLEST, CALM, MIDDLE, LARGEST = 0.35, 1.0, 1.1, 1.3
SIZED = (0, 0.6, 1, 2)
TALKER = np.array([MIDDLE, MIDDLE, 1], np.float32)  # `hands` of a speaker in the middle of the dial, both at work
DRIFT = 0.15  # how far a number wanders from what was drawn
STEP = CHUNK  # 0.27 s: every decision here holds at least so long, whatever the bundle's chunk
DRIFT_STEPS = 45  # 12 s, two or three phrases, from one drawn place to the next
TURN_STEPS, TURN_JITTER = 12, 4  # a turn: 3.2 s on average in which the same hands work
QUIET, LIVELY = 0.4, 0.72  # how busy a working hand is (`models.generator.manner.busy`) at liveliness 0 and 1
IDLE = (0.05, 0.2)  # how busy the other hand is
UNEQUAL = 0.08  # how far two working hands differ
RESTS = 0.2  # chance at liveliness 0 that neither works
STIRRED = 1.0  # how busy the leading hand is told to be where both have rested for too long; `QUIET` at liveliness 0
HANGING = 0.08  # how high an idle hand is
KEPT = 8  # turns remembered
AROUND = STEP.within(BUSY_S) // 2  # steps to either side over which a hand's busyness is averaged


class SpeakerManner:
    """The manner of one session."""

    def __init__(self, seed: int, options: MotionOptions, chunk: ChunkSize = CHUNK) -> None:
        self._seed, self._chunk = seed, chunk
        self._drawn = np.array(draw_manner(seed).values)
        for name, by in CORRECTED.items():
            self._drawn[MANNER.index(name)] += by
        self._drawn[REST] = 0  # at the sides: the model keeps idle hands before the body too often
        self._set: dict[str, float] = {}
        self._turns: dict[int, Float[np.ndarray, " hands"]] = {}  # what hands do in each turn
        self._borders: dict[int, int] = {}  # where turns begin
        self.choose(options.liveliness, options.handedness)

    def choose(self, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Set numbers between 0 and 1; what is None stays as it is. See `MotionOptions`."""
        told = {"liveliness": liveliness and liveliness * LIVELIEST, "handedness": handedness}
        self._set |= {SET[name]: value for name, value in told.items() if value is not None}
        self._turns.clear()

    def hands(self, chunk: int, *, talks: bool = True) -> Float[np.ndarray, " 3"]:
        """Sizes of the left and the right arm's moves, and 1, for a speaker who talks; else `WHOLE`."""
        if not talks:
            return WHOLE
        right = self._set.get(SET["handedness"], 0.5)
        size = np.interp(self.dial, SIZED, (SMALLEST, CALM, MIDDLE, LARGEST))
        works = np.interp(self._busy(self._step(chunk)), (IDLE[1], QUIET), (SMALLEST, 1))
        left, right = np.interp((1 - right, right), (0, 0.5), (SMALLEST, 1)) * size * works
        return np.array([left, right, 1], np.float32)

    @property
    def dial(self) -> float:
        """Twice the liveliness that a user set, so from 0 to 2; 1, the middle, if it is not set."""
        return self._set.get("liveliness", LIVELIEST / 2) / (LIVELIEST / 2)

    def at(self, chunk: int, *, is_silent: bool = False, rests: bool = False) -> Float[np.ndarray, " m"]:
        """The numbers of a chunk, in the order of `TOLD`.

        In silence both hands are idle. If both rested for too long (`rests`), the model is told that the leader works.
        """
        step = self._step(chunk)
        numbers = self._numbers(step)
        busy = np.full(2, np.mean(IDLE)) if is_silent else self._busy(step)
        if rests and not is_silent:
            busy[int(busy[1] >= busy[0])] = np.interp(self.dial, (0, 1), (QUIET, STIRRED))
            numbers[LIVELINESS] = np.interp(self.dial, (0, 1), (numbers[LIVELINESS], 1))
        high = np.full(2, np.nan) if is_silent else self._hands(step)[2:]
        return np.concatenate([numbers, busy, high]).astype(np.float32)

    def _step(self, chunk: int) -> int:
        """The step in which a chunk begins."""
        return chunk * self._chunk.tokens // STEP.tokens

    def _numbers(self, step: int) -> Float[np.ndarray, " m"]:
        """The manner in the order of `MANNER`."""
        block, into = divmod(step, DRIFT_STEPS)
        before, after = _wander(self._seed, block), _wander(self._seed, block + 1)
        values: Float[np.ndarray, " m"] = np.clip(self._drawn + before + (after - before) * into / DRIFT_STEPS, 0, 1)
        for name, value in self._set.items():
            values[MANNER.index(name)] = value
        return values

    def _busy(self, step: int) -> Float[np.ndarray, " 2"]:
        """How busy the left and the right hand are, averaged around a step so that no hand starts abruptly."""
        near = [self._hands(at)[:2] for at in range(max(0, step - AROUND), step + AROUND + 1)]
        return np.asarray(np.mean(near, axis=0))

    def _hands(self, step: int) -> Float[np.ndarray, " hands"]:
        """How busy the left and the right hand are, then how high, in the turn that the step belongs to."""
        turn = step // TURN_STEPS
        if abs(step - (turn + 0.5) * TURN_STEPS) > TURN_STEPS / 2 - TURN_JITTER - 1:  # near a border
            turn += self._border(turn + 1) <= step
            turn -= self._border(turn) > step
        if turn not in self._turns:
            self._turns = dict(list(self._turns.items())[-KEPT:]) | {turn: self._draw(turn)}
        return self._turns[turn]

    def _draw(self, turn: int) -> Float[np.ndarray, " hands"]:
        values, rng = self._numbers(self._border(turn)), np.random.default_rng([self._seed, 3, turn])
        rests, both, right, second, lively = rng.random(5)
        is_set = SET["handedness"] in self._set
        apart = abs(2 * values[RIGHT] - 1) if is_set else 0.0  # a user who asks for one hand does not want both
        working = np.full(2, both < values[BOTH] * (1 - apart))
        working[int(right < values[RIGHT])] = True
        working &= rests >= RESTS * (1 - values[LIVELINESS]) ** 2
        busy = np.full(2, QUIET + (LIVELY - QUIET) * values[LIVELINESS] + 0.2 * (lively - 0.5))
        busy[int(right >= values[RIGHT])] -= UNEQUAL * 2 * second
        busy = np.where(working, busy, rng.uniform(*IDLE, 2))
        is_told = working.any() and is_set  # otherwise an idle hand may rest anywhere
        high = np.where(~working & is_told, HANGING, np.nan)
        drawn: Float[np.ndarray, " hands"] = np.clip(np.concatenate([busy, high]), 0, 1)
        return drawn

    def _border(self, turn: int) -> int:
        """The first step of a turn."""
        if turn <= 0:
            return 0
        if turn not in self._borders:
            off = np.random.default_rng([self._seed, 4, turn]).integers(-TURN_JITTER, TURN_JITTER + 1)
            self._borders = dict(list(self._borders.items())[-KEPT:]) | {turn: turn * TURN_STEPS + int(off)}
        return self._borders[turn]


@functools.lru_cache(1024)  # a session needs two at a time
def _wander(seed: int, block: int) -> Float[np.ndarray, " m"]:
    wander = np.random.default_rng([seed, 2, block]).uniform(-DRIFT, DRIFT, len(MANNER))
    wander[REST] = 0  # where idle hands are is a habit
    return wander
