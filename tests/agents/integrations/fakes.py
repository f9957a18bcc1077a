"""An engine with a minimal pipeline, and a tone to say."""

import numpy as np
from tests.server.fakes import Body

from echoavatar.engine import Engine


def engine(step_seconds: float = 0.0, *, seats: int = 2) -> Engine:
    return Engine(Body(step_seconds), seats=seats)  # type: ignore[arg-type]


def tone(seconds: float, rate: int = 24_000, level: float = 8_000) -> np.ndarray:
    return (level * np.sin(2 * np.pi * 220 * np.arange(round(seconds * rate)) / rate)).astype(np.int16)
