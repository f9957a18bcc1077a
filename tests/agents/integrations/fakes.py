"""An engine with a minimal pipeline, a tone to say, and what a bridge tells of words."""

from typing import Any

import numpy as np
from tests.server.fakes import Body

from echoavatar.agents.integrations import AvatarBridge
from echoavatar.engine import Engine
from echoavatar.wire.messages import Words


def engine(step_seconds: float = 0.0, *, seats: int = 2) -> Engine:
    return Engine(Body(step_seconds), seats=seats)  # type: ignore[arg-type]


def tone(seconds: float, rate: int = 24_000, level: float = 8_000) -> np.ndarray:
    return (level * np.sin(2 * np.pi * 220 * np.arange(round(seconds * rate)) / rate)).astype(np.int16)


def words_told(bridge: AvatarBridge) -> list[tuple[int, str, float]]:
    """Utterance, text and start of every word that an open bridge tells from now on."""
    told: list[tuple[int, str, float]] = []
    session = bridge._session
    send = session.send

    async def noting(message: Any) -> None:
        if isinstance(message, Words):
            told.extend((message.seg, word.text, round(word.start, 3)) for word in message.words)
        await send(message)

    session.send = noting  # type: ignore[method-assign]
    return told
