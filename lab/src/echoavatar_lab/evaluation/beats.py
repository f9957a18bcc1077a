"""Beat alignment as `evaluate` reports it: the `sharp` forms of `metrics`, with a stroke delay and chance levels.

A score means nothing alone. Each comes with its chance level: the same motion against other clips' events.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

from .metrics.beat_alignment import SHARP_SIGMA_S, mean_hit_rate, overlapping
from .metrics.chance import mean_of_known, shuffled_scores
from .metrics.gesture_alignment import step_speed


def alignment_and_chance(
    events: Sequence[Float[np.ndarray, " _"]], beats: Sequence[Sequence[Float[np.ndarray, " _"]]]
) -> tuple[float, float]:
    """BA over clips, and the chance level: each clip's motion against the events of every other clip."""
    clips = [i for i, times in enumerate(events) if len(times)]

    def score(motion: int, sound: int) -> float:
        heard, own = events[clips[sound]], events[clips[motion]]
        return mean_hit_rate(overlapping(heard, own), beats[clips[motion]], SHARP_SIGMA_S)

    own = np.array([score(i, i) for i in range(len(clips))])
    return mean_of_known(own), mean_of_known(shuffled_scores(score, len(clips)))


def speed_around(
    positions: Float[np.ndarray, "t j 3"], events: Float[np.ndarray, " n"], seconds: tuple[float, float]
) -> Float[np.ndarray, " m"]:
    """Mean joint speed in this time span around each event, over its mean from a second before to a second after."""
    speed = step_speed(positions).mean(1)
    first, last = (round(second * FRAME_RATE_HZ) for second in seconds)
    at = np.round(np.asarray(events) * FRAME_RATE_HZ).astype(int)
    at = at[(at >= FRAME_RATE_HZ) & (at + FRAME_RATE_HZ < len(speed))]
    near = [speed[k + first : k + last + 1].mean() for k in at]
    wide = [speed[k - FRAME_RATE_HZ : k + FRAME_RATE_HZ].mean() + 1e-6 for k in at]
    return np.asarray(np.array(near) / np.array(wide))
