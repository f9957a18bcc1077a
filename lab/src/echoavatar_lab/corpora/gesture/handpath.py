"""Path of a hand as overlapping minimum-jerk submovements (Flash and Henis 1991): velocity never jumps.

A hand is one vector: wrist 3, palm 3, elbow swing 1, fingers 7 (`pack_hand`). A move adds the difference between the
previous aim and the new one, so a move may start before the previous one has ended.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import Array, air, minimum_jerk

HAND_WIDTH = 14
WRIST, PALM, SWING, FINGERS = slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 14)
_LIMITS = ((WRIST, 2.35, 0.0), (PALM, 8.5, 0.03), (SWING, 3.5, 0.0), (FINGERS, 5.0, 0.05))  # top speed, lag


def pack_hand(
    wrist: tuple[float, float, float] | Float[Array, " 3"],
    palm: tuple[float, float, float],
    fingers: Float[Array, " 7"],
    swing: float = 0.0,
) -> Float[Array, " 14"]:
    """One hand as a vector."""
    return np.concatenate([wrist, palm, [swing], fingers]).astype(np.float32)


class HandPath:
    """Moves of one hand, in order of their starts; `aim` is where the last one ends."""

    def __init__(self, aim: Float[Array, " 14"]) -> None:
        self.aim, self._start = aim, aim.copy()
        self._moves: list[tuple[float, float, Array, Array]] = []
        self._followed: list[tuple[float, Array]] = []

    def move(self, begin: float, end: float, aim: Float[Array, " 14"], arc: Float[Array, " 3"] | None = None) -> None:
        """Move to `aim` between two times (seconds); `arc` is the wrist's offset half-way, metres.

        Moves that were to begin later are dropped.
        """
        self._drop_later(begin)
        bulge = np.zeros(3, np.float32) if arc is None else np.asarray(arc, np.float32)
        self._moves.append((begin, end, aim - self.aim, bulge))
        self.aim = aim.copy()

    def stroke(
        self, begin: float, end: float, aim: Float[Array, " 14"], *, overshoot: float, arc: Array | None = None
    ) -> None:
        """Move past the aim by a share of the way, then settle on it within a quarter of a second."""
        past = (aim - self.aim) * overshoot
        past[PALM] *= 1.5
        goal = aim.copy()
        goal[:7] += past[:7]
        self.move(begin, end, goal, arc)
        self.move(end - 0.03, end + 0.24, aim)

    def follow(self, begin: float, curve: Float[Array, "n 14"], blend_s: float) -> None:
        """Follow a curve at 30 fps from a time on, blended in over some seconds. Moves that were to begin later go."""
        self._drop_later(begin)
        share = minimum_jerk(np.arange(len(curve)) / (blend_s * FRAME_RATE_HZ))
        self._followed.append((begin, share[:, None] * (curve - self.aim)))
        self.aim = self.aim + self._followed[-1][1][-1]

    def _drop_later(self, begin: float) -> None:
        while self._moves and self._moves[-1][0] >= begin:
            self.aim = self.aim - self._moves.pop()[2]

    def curve(self, frames: int) -> Float[Array, "t 14"]:
        """The path at the frame rate. A move that would be too fast takes longer; palm and fingers lag the wrist."""
        out = np.zeros((frames, HAND_WIDTH), np.float64)
        done = np.zeros((frames + 1, HAND_WIDTH), np.float64)
        for begin, end, change, bulge in self._moves:
            for channels, fastest, lag in _LIMITS:
                part = change[channels]
                way = float(np.linalg.norm(part) if channels == WRIST else np.abs(part).max())
                seconds = max(end - begin, 1.875 * way / fastest, 0.1)
                first, last = _window(begin + lag, begin + lag + seconds, frames)
                done[last, channels] += change[channels]
                if last > first:
                    phase = (np.arange(first, last) / FRAME_RATE_HZ - begin - lag) / seconds
                    progress = minimum_jerk(phase)[:, None]
                    out[first:last, channels] += progress * change[channels]
                    if channels == WRIST and bulge.any():
                        out[first:last, channels] += air(phase)[:, None] * bulge
        for begin, shape in self._followed:
            first, last = _window(begin, begin + len(shape) / FRAME_RATE_HZ, frames)
            out[first:last] += shape[: last - first]
            done[last] += shape[-1]
        return np.asarray(self._start + out + done.cumsum(axis=0)[:-1], np.float32)


def _window(begin: float, end: float, frames: int) -> tuple[int, int]:
    """First and last frame of a move, limited to the clip."""
    first = int(np.ceil(begin * FRAME_RATE_HZ))
    last = int(np.ceil(end * FRAME_RATE_HZ))
    return min(max(first, 0), frames), min(max(last, 0), frames)
