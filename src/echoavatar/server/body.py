"""Read the body of a request within bounds of size and time."""

import anyio
from starlette.requests import ClientDisconnect, Request

from echoavatar.errors import EchoAvatarError

SECONDS = 15.0


async def read_body(request: Request, most: int, *, seconds: float = SECONDS) -> bytes:
    """The whole body.

    Raises:
        EchoAvatarError: the body has more than `most` bytes, or does not arrive in time.
    """
    body = bytearray()
    try:
        with anyio.fail_after(seconds):
            async for part in request.stream():
                body += part
                if len(body) > most:
                    raise EchoAvatarError(f"the body has more than {most} bytes")
    except (TimeoutError, ClientDisconnect) as error:
        raise EchoAvatarError(f"the body did not come within {seconds:g} s") from error
    return bytes(body)
