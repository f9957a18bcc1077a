"""A small warp model, and clips of clicks: silence, and a click where each event is."""

import numpy as np

from echoavatar.data import Clip
from echoavatar.models.face import MelConfig
from echoavatar.models.warp import WarpConfig

CONFIG = WarpConfig(encoder=MelConfig(bands=8, windows=2, width=16, blocks=2, past=4))


def clicks(frames: int = 240, seed: int = 0, *, kind: str = "beats") -> Clip:
    """A click (10 ms of noise) at each event, some 0.6 s apart."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.4, 0.8, 40))
    times = times[times < frames / 30 - 0.3]
    audio = 0.001 * rng.standard_normal(800 * frames)
    for time in times:
        at = round(time * 24_000)
        audio[at : at + 240] += 0.5 * rng.standard_normal(240)
    return Clip(
        name=f"clicks-{seed}",
        audio=audio.astype(np.float32),
        rotations=np.tile(np.float32([1, 0, 0, 0]), (frames, 52, 1)),
        root=np.zeros((frames, 3), np.float32),
        domain=np.zeros(frames, np.uint8),
        events={kind: times},
    )
