"""Gesture forms for accents and meanings: where a hand goes, how it is turned and how it is shaped."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.models.generator.manner import Manner

from ..controls import Array
from .handpath import pack_hand
from .handshapes import hand_shape

HOME = (0.025, -0.210, 0.200)  # relaxed wrist position in gesture space, from the shoulder
SPACE = (0.08, 0.08, 0.0)  # by which homes lie further out and higher in the widest gesture space than in the narrowest
EASY_REACH, LEAST_REACH = 0.43, 0.25  # metres from the shoulder
GESTURE_SPACE = ((-0.11, -0.43, 0.12), (0.22, 0.05, 0.42))  # of the wrist, from the shoulder, metres
HOME_SHAPES = ("relaxed", "open", "bowl", "pinch", "flat", "loose fist")


@dataclass(frozen=True)
class Form:
    """An aim relative to home: wrist offset (metres), palm angles, hand shape, elbow swing, arc of the path."""

    wrist: tuple[float, float, float]
    palm: tuple[float, float, float]
    shape: str
    swing: float = 0.0
    arc: tuple[float, float, float] = (0.0, 0.04, 0.02)


ACCENTS: dict[str, Form] = {
    "offer": Form((0.07, 0.04, 0.10), (-0.15, 0.0, -1.05), "offer", -0.10),
    "open out": Form((0.16, 0.06, 0.05), (-0.20, -0.05, -0.80), "open", 0.05, (0.0, 0.03, 0.05)),
    "chop": Form((0.02, -0.05, 0.09), (0.0, -0.20, 0.15), "flat", 0.0, (0.0, 0.07, -0.02)),
    "precision": Form((0.02, 0.09, 0.05), (0.15, 0.05, 0.60), "pinch", 0.05, (0.02, 0.05, 0.0)),
    "push": Form((0.05, 0.09, 0.13), (-0.55, 0.0, 1.10), "open", 0.10, (0.0, -0.02, -0.02)),
    "brush": Form((0.19, 0.0, 0.04), (-0.25, -0.20, 0.75), "relaxed", 0.15, (-0.03, 0.05, 0.03)),
    "hold": Form((-0.03, 0.06, 0.05), (0.10, 0.0, 0.05), "bowl", 0.0, (0.03, 0.02, 0.02)),
    "grip": Form((0.0, 0.08, 0.05), (0.10, 0.05, 0.45), "loose fist", 0.05, (0.02, 0.03, 0.0)),
    "raise": Form((0.04, 0.22, 0.06), (-0.15, 0.0, -0.30), "open", 0.10, (0.03, 0.0, 0.04)),
    "sweep across": Form((-0.15, 0.03, 0.08), (0.10, 0.0, 0.30), "flat", 0.15, (0.02, 0.05, 0.06)),
    "together": Form((-0.13, 0.02, 0.07), (0.05, 0.0, 0.05), "bowl", 0.05, (0.04, 0.04, 0.02)),
    "far": Form((0.12, 0.06, 0.17), (-0.30, 0.0, -0.60), "offer", 0.0, (0.0, 0.05, 0.0)),
    "drop": Form((0.07, -0.13, 0.03), (0.10, -0.10, 0.30), "relaxed", 0.0, (0.02, 0.06, 0.02)),
    "aside": Form((0.24, 0.10, -0.02), (-0.25, -0.10, -0.50), "open", 0.10, (0.0, 0.03, 0.07)),
    "turn over": Form((0.09, -0.01, 0.07), (-0.10, 0.0, -1.20), "open", -0.05, (0.03, 0.06, 0.0)),
}

MEANINGS: dict[str, Form] = {
    "size": Form((0.15, 0.09, 0.07), (0.05, 0.0, 0.12), "bowl", 0.12, (0.0, 0.02, 0.06)),
    "small": Form((-0.055, 0.10, 0.07), (0.12, 0.0, 0.30), "pinch", 0.12, (0.05, 0.04, 0.0)),
    "there": Form((0.20, 0.19, 0.15), (-0.05, 0.05, 0.55), "point", 0.12, (0.0, 0.02, 0.03)),
    "here": Form((0.02, -0.04, 0.15), (0.30, -0.15, 0.85), "point", 0.05, (0.0, 0.09, 0.0)),
    "you": Form((0.02, 0.07, 0.17), (-0.20, 0.0, -0.95), "offer", -0.05, (0.0, 0.03, 0.0)),
    "me": Form((-0.115, 0.085, -0.035), (0.20, 0.0, 0.40), "open", 0.12, (0.06, 0.03, 0.08)),
    "negation": Form((0.22, 0.0, 0.06), (-0.25, -0.15, 1.15), "flat", 0.25, (0.0, 0.0, 0.09)),
    "count": Form((0.06, 0.22, 0.02), (-0.15, 0.0, 0.85), "one", -0.15, (0.02, 0.03, 0.04)),
    "contrast": Form((0.17, 0.03, 0.07), (-0.10, 0.0, -0.95), "offer", -0.05, (0.0, 0.06, 0.03)),
    "question": Form((0.14, 0.02, 0.08), (-0.15, 0.0, -1.20), "open", -0.10, (0.0, 0.02, 0.05)),
    "greeting": Form((0.20, 0.37, 0.02), (-0.25, 0.0, 1.15), "spread", -0.40, (0.03, 0.0, 0.06)),
}

_SMALL = frozenset(["tiny", "small", "little", "short", "thin", "narrow", "less", "least"])
_ME = frozenset(["i", "me", "my", "mine", "myself", "we", "us", "our"])
_YOU = frozenset(["you", "your", "yours", "yourself", "everybody", "everyone"])
_HERE = frozenset(["here", "this", "these", "down", "now"])


def meant_form(meaning: str, word: str) -> str:
    """The name in `MEANINGS` of the form for a word with a meaning."""
    bare = word.lower().strip(".,;:!?'\"")
    if meaning == "size":
        return "small" if bare in _SMALL else "size"
    if meaning == "deixis":
        groups = (("me", _ME), ("you", _YOU), ("here", _HERE))
        return next((name for name, words in groups if bare in words), "there")
    return meaning


def aim_at(form: Form, home: Float[Array, " 14"], *, size: float, rng: np.random.Generator) -> Float[Array, " 14"]:
    """The hand vector of a form, relative to the hand's present home and with random variation."""
    wrist = 0.45 * np.array(HOME) + 0.55 * home[:3] + np.array(form.wrist) * size + rng.normal(0, 0.02, 3)
    palm = np.array(form.palm) + rng.normal(0, 0.12, 3)
    fingers = (hand_shape(form.shape) + rng.normal(0, 0.03, 7)).astype(np.float32)
    wrist = in_gesture_space(wrist)
    swing = form.swing + float(rng.normal(0, 0.05)) - _dropped(wrist)
    return pack_hand(wrist, (palm[0], palm[1], palm[2]), fingers, swing)


def _dropped(wrist: Float[Array, " 3"]) -> float:
    """By how much the elbow hangs, radians: it stays down while the hand rises."""
    return 1.2 * max(float(wrist[1]) + 0.3, 0.0)


def eased_reach(wrist: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The wrist aim neither too far from the shoulder nor too near: at both ends elbows turn too fast."""
    far = float(np.linalg.norm(wrist))
    easy = EASY_REACH + 0.4 * (far - EASY_REACH) if far > EASY_REACH else max(far, LEAST_REACH)
    return np.asarray(wrist * (easy / far), np.float32)


def in_gesture_space(wrist: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The wrist aim where speakers gesture: in front of the trunk, not before the face, the elbow bent.

    Low hands are near the body and high ones ahead of it: elsewhere elbows stand out.
    """
    low, high = GESTURE_SPACE
    across, up, ahead = np.clip(wrist, low, high)
    over_chest = float(np.clip((up + 0.15) / 0.15, 0, 1))
    across = np.clip(across, low[0] + over_chest * 0.17, 0.1 + 0.4 * (up - low[1]))
    ahead = max(ahead, low[2] + 0.3 * max(up + 0.25, 0.0))
    return eased_reach(np.array([across, up, ahead], np.float32))


def home_of(manner: Manner, rng: np.random.Generator) -> Float[Array, " 14"]:
    """A random home in a speaker's gesture space, from which a hand makes its beats."""
    wrist = np.array(HOME) + (wide := manner.space - 0.5) * np.array(SPACE)
    wrist = wrist + rng.normal(0, (0.06, 0.065, 0.045)) * (1.15 + 0.5 * wide)
    shape = HOME_SHAPES[rng.choice(len(HOME_SHAPES), p=(0.30, 0.25, 0.16, 0.13, 0.08, 0.08))]
    palm = (float(rng.normal(-0.05, 0.12)), float(rng.normal(0, 0.05)), float(rng.uniform(-0.85, 0.85)))
    wrist = in_gesture_space(wrist)
    return pack_hand(wrist, palm, hand_shape(shape), float(rng.normal(0.04, 0.08)) - _dropped(wrist))
