"""Named hand shapes as finger controls: curl of thumb to little finger, spread, thumb opposition."""

import numpy as np
from jaxtyping import Float

from ..controls import RELAXED_FINGERS

HAND_SHAPES: dict[str, tuple[float, ...]] = {
    "relaxed": RELAXED_FINGERS,
    "open": (0.10, 0.08, 0.09, 0.12, 0.15, 0.35, 0.10),
    "offer": (0.12, 0.10, 0.15, 0.21, 0.25, 0.25, 0.15),
    "flat": (0.20, 0.03, 0.03, 0.04, 0.06, -0.25, 0.15),
    "spread": (0.02, 0.02, 0.02, 0.04, 0.05, 0.85, 0.05),
    "bowl": (0.25, 0.27, 0.28, 0.30, 0.32, 0.40, 0.50),
    "pinch": (0.34, 0.47, 0.42, 0.38, 0.36, 0.15, 0.85),
    "point": (0.55, 0.02, 0.74, 0.82, 0.85, 0.0, 0.60),
    "loose fist": (0.40, 0.52, 0.60, 0.66, 0.68, 0.0, 0.40),
    "fist": (0.55, 0.90, 0.93, 0.94, 0.94, -0.20, 0.60),
    "clasp": (0.35, 0.36, 0.40, 0.42, 0.42, -0.20, 0.30),
    "one": (0.55, 0.02, 0.80, 0.86, 0.88, 0.0, 0.65),
    "two": (0.60, 0.02, 0.03, 0.84, 0.86, 0.60, 0.75),
    "three": (0.65, 0.02, 0.02, 0.05, 0.84, 0.55, 0.85),
    "four": (0.70, 0.02, 0.02, 0.03, 0.05, 0.60, 0.90),
    "five": (0.02, 0.02, 0.02, 0.02, 0.03, 0.90, 0.0),
}

COUNTS = {  # the words that each counting shape shows; "five" also shows any other word
    "one": ("one", "first", "once", "single", "1"),
    "two": ("two", "second", "twice", "both", "couple", "2"),
    "three": ("three", "third", "3"),
    "four": ("four", "fourth", "4"),
}


def hand_shape(name: str) -> Float[np.ndarray, " 7"]:
    """Finger controls of a named shape; raises KeyError for an unknown name."""
    return np.array(HAND_SHAPES[name], np.float32)


def count_shape(word: str) -> str:
    """The counting shape for a number word; any other word gives all five fingers."""
    bare = word.lower().strip(".,;:!?'\"")
    return next((shape for shape, words in COUNTS.items() if bare in words), "five")
