"""The 52 ARKit blendshapes: names, orders, and maps to Live Link Face and VRM.

Paper, Facial Animation: "industry-standard Apple ARKit blendshape schema". The canonical order here is that of Live
Link Face, with which the paper's data was captured: the right side of jaw and mouth comes before the left. Apple's
headers and alphabetical lists use other orders, so curves are always stored with their names.

All maps take curves (t, 52) in canonical order, 0 (rest) to 1 (full).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError

ARKIT_NAMES: tuple[str, ...] = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft",
    "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight",
    "eyeSquintRight", "eyeWideRight", "jawForward", "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel",
    "mouthPucker", "mouthRight", "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft",
    "mouthFrownRight", "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight",
    "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft",
    "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft",
    "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip
HEAD_AND_EYES: tuple[str, ...] = (
    "headYaw", "headPitch", "headRoll", "leftEyeYaw", "leftEyePitch", "leftEyeRoll",
    "rightEyeYaw", "rightEyePitch", "rightEyeRoll",
)  # fmt: skip
LIVE_LINK_NAMES = ARKIT_NAMES + HEAD_AND_EYES  # the 61 columns of a Live Link Face take
_SWAPPED = {"jawRight": "jawLeft", "jawLeft": "jawRight", "mouthRight": "mouthLeft", "mouthLeft": "mouthRight"}
APPLE_NAMES = tuple(_SWAPPED.get(name, name) for name in ARKIT_NAMES)  # also the released model's 52 channels

VRM_NAMES = (
    "aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft", "blinkRight", "lookUp", "lookDown", "lookLeft", "lookRight",
)  # fmt: skip
Curves = Float[np.ndarray, "t 52"]
_INDEX = {name: index for index, name in enumerate(ARKIT_NAMES)}
_EYE_RADIANS = 0.6  # rotation of an eye at a look curve of 1, as in takes of Live Link Face


def reorder(
    curves: Float[np.ndarray, "t n"], names: Sequence[str], wanted: Sequence[str] = ARKIT_NAMES
) -> Float[np.ndarray, "t m"]:
    """Reorder columns; names without a source are 0.

    Raises MotionError if there is not exactly one name per column, or a name occurs twice.
    """
    if len(names) != curves.shape[1] or len(set(names)) != len(names):
        raise MotionError(f"{curves.shape[1]} columns but {len(set(names))} different names; give one name for each")
    source = {name: column for column, name in enumerate(names)}
    out = np.zeros((len(curves), len(wanted)), np.float32)
    for place, name in enumerate(wanted):
        if name in source:
            out[:, place] = curves[:, source[name]]
    return out


def to_live_link(curves: Curves) -> Float[np.ndarray, "t 61"]:
    """The 61 columns of Live Link Face: the curves, a head that looks ahead, and eyes that follow the look curves."""
    parts = [curves, np.zeros((len(curves), 3), np.float32)]
    for side in ("Left", "Right"):
        get = {name: curves[:, _INDEX[f"eyeLook{name}{side}"]] for name in ("Up", "Down", "In", "Out")}
        yaw = (get["Out"] - get["In"]) * (-1 if side == "Left" else 1) * _EYE_RADIANS
        pitch = (get["Down"] - get["Up"]) * _EYE_RADIANS
        parts.append(np.stack([yaw, pitch, np.zeros_like(yaw)], axis=1))
    return np.concatenate(parts, axis=1).astype(np.float32)


def to_vrm(curves: Curves) -> Float[np.ndarray, "t 12"]:
    """The VRM expressions `VRM_NAMES`, 0 to 1: five vowels, blinks and gaze directions.

    An open mouth is divided among aa, oh and ou by its roundness, and among aa, ee and ih by its width. The vowels sum
    to at most 1, because blended vowel shapes would otherwise break the mesh.
    """
    opening, funnel, pucker, width = _mouth(curves).T
    round_ = np.clip(funnel + pucker, 0, 1)
    wide = np.clip(2 * width, 0, 1) * (1 - round_)
    vowels = np.stack(
        [
            1.6 * opening * (1 - round_) * (1 - 0.6 * wide),
            1.2 * opening * (1 - round_) * 0.4 * wide + 0.25 * wide * np.minimum(1, 6 * opening),
            np.clip(pucker, 0, 1) * (1 - 0.5 * opening),
            1.2 * opening * wide + 0.3 * wide * np.minimum(1, 6 * opening),
            1.4 * opening * round_ + 0.5 * funnel * (1 - np.clip(pucker, 0, 1)),
        ]
    )
    vowels = vowels / np.maximum(1, vowels.sum(0))
    left, right = (np.clip(curves[:, _INDEX[f"eyeBlink{side}"]], 0, 1) for side in ("Left", "Right"))
    both = np.minimum(left, right)
    look = {
        name: np.mean([curves[:, _INDEX[column]] for column in columns], axis=0)
        for name, columns in {
            "up": ("eyeLookUpLeft", "eyeLookUpRight"),
            "down": ("eyeLookDownLeft", "eyeLookDownRight"),
            "left": ("eyeLookOutLeft", "eyeLookInRight"),
            "right": ("eyeLookInLeft", "eyeLookOutRight"),
        }.items()
    }
    eyes = np.stack([both, left - both, right - both, look["up"], look["down"], look["left"], look["right"]])
    return np.asarray(np.clip(np.concatenate([vowels, eyes]).T, 0, 1), np.float32)


def mouth_opening(curves: Curves) -> Float[np.ndarray, " t"]:
    """The gap between the lips: `jawOpen` less `mouthClose`."""
    apart = curves[:, _INDEX["jawOpen"]] - curves[:, _INDEX["mouthClose"]]
    return np.asarray(np.clip(apart, 0, 1))


def _mouth(curves: Curves) -> Float[np.ndarray, "t 4"]:
    """Opening, funnel, pucker and width."""

    def mean(*names: str) -> Float[np.ndarray, " t"]:
        return np.asarray(np.mean([curves[:, _INDEX[name]] for name in names], axis=0))

    def pair(name: str) -> Float[np.ndarray, " t"]:
        return mean(f"{name}Left", f"{name}Right")

    width = np.maximum(np.maximum(pair("mouthStretch"), pair("mouthSmile")), pair("mouthDimple"))
    return np.stack([mouth_opening(curves), mean("mouthFunnel"), mean("mouthPucker"), width], axis=1)
