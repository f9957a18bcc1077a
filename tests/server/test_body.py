import asyncio
from collections.abc import Iterable

import pytest
from starlette.requests import Request
from starlette.types import Message

from echoavatar.errors import EchoAvatarError
from echoavatar.server.body import read_body


def request(parts: Iterable[bytes], pause: float = 0.0) -> Request:
    left = list(parts)

    async def receive() -> Message:
        await asyncio.sleep(pause)
        part = left.pop(0)
        return {"type": "http.request", "body": part, "more_body": bool(left)}

    return Request({"type": "http", "method": "POST", "headers": []}, receive)


def test_a_body_is_read_whole() -> None:
    assert asyncio.run(read_body(request([b"one ", b"two"]), 7)) == b"one two"


def test_a_body_is_bounded_in_size_and_time() -> None:
    with pytest.raises(EchoAvatarError, match="more than 6 bytes"):
        asyncio.run(read_body(request([b"one ", b"two"]), 6))
    with pytest.raises(EchoAvatarError, match="did not come within 0.05 s"):
        asyncio.run(read_body(request([b"x"] * 100, pause=0.02), 1_000, seconds=0.05))
