"""Faces for other programs: a take as Live Link Face writes it, curves at another frame rate."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import LIVE_LINK_NAMES, to_live_link
from echoavatar.whole_file import write_whole


def write_live_link(path: Path, curves: Float[np.ndarray, "t 52"], fps: float = 30.0) -> None:
    """Write curves as a Live Link Face CSV (61 columns, timecode from 00:00:00 at 30 or 60 frames per second).

    Raises:
        MotionError: the file cannot be written.
    """
    base = 60 if fps > 30 else 30
    head = ["Timecode", "BlendshapeCount", *(name[:1].upper() + name[1:] for name in LIVE_LINK_NAMES)]
    rows = [",".join(head)]
    for frame, values in enumerate(to_live_link(curves)):
        stamp = _timecode(frame / fps, base)
        rows.append(",".join([stamp, str(len(values)), *(f"{value:.6f}" for value in values)]))
    write_whole(path, "\n".join(rows) + "\n", error=MotionError)


def _timecode(seconds: float, base: int) -> str:
    """hh:mm:ss:ff.fff, ff counting 1/base s."""
    thousandths = round(seconds * base * 1000)
    whole, part = divmod(thousandths, base * 1000)
    minutes, second = divmod(whole, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}:{minute:02d}:{second:02d}:{part // 1000:02d}.{part % 1000:03d}"
