"""Listening: signs in the user's speech that the avatar reacts to. Not in the paper.

The user's sound does not drive the motion model: the avatar does not gesture to the words of others. While the user
speaks it takes a listening posture; at some pauses after a stretch of speech it nods. Decisions depend on the user's
own sample clock and the session's seed, so they can be repeated.
"""

import hashlib
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.timing import SAMPLE_RATE_HZ

FRAME = 480  # samples, 20 ms
SOUND_DB = -45.0  # quieter sound is not speech
OVER_FLOOR_DB = 9.0  # speech is louder than the noise floor by this much
PAUSE_S = 0.30  # of silence before a nod
TURN_S = 1.0  # of silence that ends the user's turn
LEAST_SPEECH_S = 0.9  # of speech before a nod
LEAST_GAP_S = 2.5  # between nods
NOD_S = 1.6  # from the pause until the posture is taken again
NOD_SHARE = 0.7  # of the pauses that may have a nod

Sign = Literal["begins", "pause", "ends"]


class Noticed(NamedTuple):
    """A change in the user's speech, and its place on the user's clock."""

    sign: Sign
    sample: int


class Listener:
    """Detects speech, pauses and ends in one user's sound, 24 kHz mono."""

    def __init__(self, seed: int = 0) -> None:
        self.is_listening = False
        self._seed = seed
        self._rest = np.zeros(0, np.float32)
        self._at = 0  # samples analysed
        self._floor = -70.0
        self._speech = 0.0  # seconds of speech since the last pause
        self._silence = TURN_S
        self._nodded, self._has_nodded = -LEAST_GAP_S, False

    def hear(self, sound: Float[np.ndarray, " s"]) -> list[Noticed]:
        """Take the next samples; returns the changes found in them."""
        sound = np.concatenate([self._rest, sound])
        whole = len(sound) // FRAME * FRAME
        self._rest = sound[whole:]
        noticed: list[Noticed] = []
        for frame in sound[:whole].reshape(-1, FRAME):
            noticed += self._judge(frame)
        return noticed

    def end(self) -> list[Noticed]:
        """The user's sound has ended, which need not end in silence."""
        was, self.is_listening, self._speech, self._silence = self.is_listening, False, 0.0, TURN_S
        return [Noticed("ends", self._at)] if was else []

    def _judge(self, frame: Float[np.ndarray, " f"]) -> list[Noticed]:
        level = 10 * np.log10(float(np.mean(np.square(frame, dtype=np.float64))) + 1e-10)
        self._floor = min(self._floor + 0.06, level) if level > -90 else self._floor
        self._at += FRAME
        step = FRAME / SAMPLE_RATE_HZ
        if level > max(SOUND_DB, self._floor + OVER_FLOOR_DB):
            self._silence, self._speech = 0.0, self._speech + step
            # After a nod the posture is taken again.
            is_over = self._has_nodded and self._at / SAMPLE_RATE_HZ - self._nodded > NOD_S
            if self._speech > 0.1 and (is_over or not self.is_listening):
                self.is_listening, self._has_nodded = True, False
                return [Noticed("begins", self._at)]
            return []
        before, self._silence = self._silence, self._silence + step
        if self.is_listening and before < PAUSE_S <= self._silence:
            return self._pause()
        if self.is_listening and self._silence >= TURN_S:
            self.is_listening, self._speech = False, 0.0
            return [Noticed("ends", self._at)]
        return []

    def _pause(self) -> list[Noticed]:
        now = self._at / SAMPLE_RATE_HZ
        spoken, self._speech = self._speech, 0.0
        if spoken < LEAST_SPEECH_S or now - self._nodded < LEAST_GAP_S or self._draw() > NOD_SHARE:
            return []
        self._nodded, self._has_nodded = now, True
        return [Noticed("pause", self._at)]

    def _draw(self) -> float:
        """A random number in 0..1 that depends on the seed and the clock alone."""
        word = hashlib.blake2b(f"{self._seed}:{self._at}".encode(), digest_size=4).digest()
        return int.from_bytes(word) / 2**32
