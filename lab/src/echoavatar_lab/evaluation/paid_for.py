"""The rows that a reward, a target or a choice of ours was paid for: one set, which every table marks.

A marked row tells whether the method did what it was paid for. Only an unmarked row tells how a person would see the
body. Whoever adds a reward, a target or a choice by a row adds the row here.
"""

from .metrics.liveliness import STATISTICS
from .metrics.tells import TELLS

PAID_FOR = frozenset(
    {
        *STATISTICS,  # targets of `align targets`, and how a library and a corpus were chosen
        *("told_apart", "frechet"),  # the opponent's classifier sees the same nine statistics
        *("jerk", "silence_hand_speed_ratio", "ba_beat", "ba_onset", "beat_excess", "onset_excess"),  # targets
        "stroke_contrast",  # the reward `stresses`
        *TELLS,  # how the stage `stillness`, the manner of a session and the share of a soup were chosen
        *("stillest", "rest_s", "rest_share"),  # arms at rest that the engine frees
    }
)
LEGEND = "* a reward, target or choice of ours was paid for this row"


def marked(name: str) -> str:
    """The name of a row, with an asterisk if it was paid for."""
    return f"{name}*" if name.removeprefix("recordings_") in PAID_FOR else name
