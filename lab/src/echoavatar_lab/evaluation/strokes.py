"""When hands move beside the stresses of speech: their mean speed about a stressed syllable, over chance.

0.4 at -0.1 s says: a tenth of a second before a stressed vowel the hands are faster than at any time by 0.4 of their
mean speed. The end of a person's stroke falls on the stress (Loehr 2012, doi 10.1515/lp-2012-0006), so that the hands
are fastest before it. Stresses are those that `recording_labels` finds. Not in the paper.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording

from .metrics.liveliness import SPEECH
from .metrics.tells import Moves
from .takes import Take, points_of

BEFORE_S, AFTER_S, EVERY_S = 0.4, 0.5, 0.1


class Response(NamedTuple):
    """A side's mean over stresses: by time, and where it is highest."""

    profile: Float[np.ndarray, " t"]  # from `BEFORE_S` before to `AFTER_S` after a stress, every frame
    stresses: int

    @classmethod
    def of(cls, takes: Iterable[Take]) -> Self:
        """Measure the takes of speech that have sound; NaN if there are none."""
        before, after = (round(seconds * FRAME_RATE_HZ) for seconds in (BEFORE_S, AFTER_S))
        around = []
        for take in takes:
            if take.kind != SPEECH or take.audio is None:
                continue
            speed = Moves.of(points_of(take)).speed.mean(1)
            frames = np.round(np.array(track_from_recording(take.audio, "speech").stresses) * FRAME_RATE_HZ).astype(int)
            relative = speed / (speed.mean() + 1e-9) - 1
            around += [relative[at - before : at + after + 1] for at in frames if before <= at < len(speed) - after]
        profile = np.mean(around, 0) if around else np.full(before + after + 1, np.nan)
        return cls(profile, len(around))

    @property
    def fastest_s(self) -> float:
        """When the hands are fastest, seconds after the stress."""
        return float(np.argmax(self.profile)) / FRAME_RATE_HZ - BEFORE_S


def as_text(sides: Mapping[str, Response]) -> str:
    """A row for each side."""
    times = np.arange(-BEFORE_S, AFTER_S + EVERY_S / 2, EVERY_S)
    lines = [
        "hands' speed about a stress, over its mean; s:" + "".join(f"{time:>7.1f}" for time in times) + "  highest"
    ]
    for name, side in sides.items():
        if not side.stresses:
            lines.append(f"{name}: no speech with sound")
            continue
        shown = side.profile[:: round(EVERY_S * FRAME_RATE_HZ)]
        best = f"{side.profile.max():.2f} at {side.fastest_s:+.2f} s"
        lines.append(
            f"{name + f' ({side.stresses} stresses)':<46}" + "".join(f"{x:>7.2f}" for x in shown) + f"  {best}"
        )
    return "\n".join(lines)


def as_json(sides: Mapping[str, Response]) -> dict[str, object]:
    """By side: the stresses, the highest value and its time."""
    return {
        name: {"stresses": side.stresses, "highest": float(side.profile.max()), "at_s": side.fastest_s}
        for name, side in sides.items()
        if side.stresses
    }


def responses(ours: Sequence[Take], people: Sequence[Take]) -> dict[str, Response]:
    """Those of people and ours."""
    return {"people": Response.of(people), "ours": Response.of(ours)}
