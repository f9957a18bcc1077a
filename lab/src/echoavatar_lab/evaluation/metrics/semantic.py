"""SRGR, the recall of gestures that mean something (Liu et al., BEAT, ECCV 2022, arXiv 2203.05297).

    SRGR = sum over frames of lambda_t (1/J) sum over joints [ |p - p'| < delta ] / (T * lambda_mean)

lambda_t is a label of how much the gesture in frame t means, delta 0.1 m, positions in metres with both roots at the
origin. BEAT's code divides by 0.165, the labels' mean in its data, so that only there a perfect score is 1; without
labels every frame weighs 1. Labels are BEAT's `sem` files: lines of name, start, end, duration, score and words,
separated by tabs.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.limits import read_text
from echoavatar.timing import FRAME_RATE_HZ

DELTA_M, BEAT_MEAN = 0.1, 0.165
_START, _END, _SCORE = 1, 2, 4


def srgr(
    made: Float[np.ndarray, "t j 3"], true: Float[np.ndarray, "t j 3"], labels: Float[np.ndarray, " t"] | None = None
) -> float:
    """The recall of one clip; weigh clips by their length."""
    hits = (np.linalg.norm(np.asarray(made, float) - true, axis=-1) < DELTA_M).mean(1)
    return float(hits.mean() if labels is None else (hits * labels).mean() / BEAT_MEAN)


def read_labels(path: Path, frames: int) -> Float[np.ndarray, " t"]:
    """The label of each frame, 0 where there is none.

    Raises:
        EchoAvatarError: the file cannot be read, or a line has no times or score.
    """
    found = np.zeros(frames)
    times = np.arange(frames) / FRAME_RATE_HZ
    for number, line in enumerate(read_text(path, "give BEAT's sem files, NAME.txt").splitlines(), 1):
        cells = line.split("\t")
        if line.strip():
            try:
                start, end, score = (float(cells[at]) for at in (_START, _END, _SCORE))
            except (ValueError, IndexError) as error:
                raise EchoAvatarError(
                    f"{path}, line {number}: {line!r} has no start, end and score in columns 2, 3 and 5 (tabs)"
                ) from error
            found[(times >= start) & (times <= end)] = score
    return found
