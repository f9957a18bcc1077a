"""Actions that captured people and animators gave, kept as keys in `captured_actions.json`. Legs are left out.

So they can be made for any tokenizer without the recordings; `scripts/make_captured_actions.py` cuts them again.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from echoavatar.json_reader import read_object_file

from ..controls import Array, Controls, neutral

TABLE = Path(__file__).with_name("captured_actions.json")
UNIT = 1e-3  # of the stored numbers: millimetres, milliradians
KEY_FRAMES = 4  # frames from key to key
KEPT = ("spine", "head", "shoulder", "wrist", "palm", "elbow_swing", "fingers")


@dataclass(frozen=True, eq=False)
class CapturedAction:
    """One action: its curves at 30 fps from rest to rest, the seconds that repeat, and its meaning."""

    controls: Controls
    hold: tuple[float, float]
    about: str


@cache
def captured_actions() -> dict[str, CapturedAction]:
    """The actions of `captured_actions.json`, by name."""
    return {name: unpacked(row) for name, row in read_object_file(TABLE).items()}


def unpacked(row: dict[str, Any]) -> CapturedAction:
    """An action of its row in the file."""
    frames = int(row["frames"])
    curves = CubicSpline(key_frames(frames), np.array(row["keys"]) * UNIT)(np.arange(frames))
    body, start, parts = neutral(frames), 0, {}
    for name in KEPT:
        like = getattr(body, name)
        width = like[0].size
        parts[name] = curves[:, start : start + width].reshape(like.shape).astype(np.float32)
        start += width
    first, last = row["hold"]
    return CapturedAction(replace(body, **parts), (first, last), row["about"])


def key_frames(frames: int) -> Array:
    """Frames of the keys, the last one included."""
    return np.unique(np.append(np.arange(0, frames, KEY_FRAMES), frames - 1))
