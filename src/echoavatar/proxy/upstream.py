"""The line to the voice agent: the client's own credentials and query, at the upstream's address.

Headers are passed on and never written anywhere: the library that could log them gets a logger that cannot.
"""

import logging
from collections.abc import Iterable
from urllib.parse import parse_qsl, urlencode, urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

__all__ = ["MAX_BYTES", "InvalidStatus", "dial", "passed_on", "quiet_logger", "upstream_url"]

MAX_BYTES = 1 << 26  # of one event; vendors allow up to 15 MiB
PATIENCE_S = 15.0
PING_S, PONG_S = 30.0, 120.0  # a slow reader answers late, and is not cut off for it
_OURS = {
    "connection",
    "content-length",
    "cookie",  # of this host, not theirs
    "host",
    "keep-alive",
    "origin",
    "proxy-authorization",
    "proxy-connection",
    "te",
    "trailer",
    "transfer-encoding",
    "upgrade",
}


def quiet_logger() -> logging.Logger:
    """A logger that never says what is in a request: the library writes headers at DEBUG."""
    logger = logging.getLogger("echoavatar.proxy.line")
    logger.setLevel(logging.ERROR)
    return logger


def upstream_url(upstream: str, path: str) -> str:
    """The upstream with the query of the client's request; what both name, the client decides."""
    parts = urlsplit(upstream)
    asked = parse_qsl(urlsplit(path).query, keep_blank_values=True)
    named = {key for key, _ in asked}
    own = [pair for pair in parse_qsl(parts.query, keep_blank_values=True) if pair[0] not in named]
    return urlunsplit((parts.scheme, parts.netloc, parts.path, urlencode(own + asked), ""))


def passed_on(headers: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """What of a client's headers the upstream gets: all but those of this one connection."""
    return [
        (name, value)
        for name, value in headers
        if name.lower() not in _OURS and not name.lower().startswith("sec-websocket-")
    ]


async def dial(
    url: str, headers: Iterable[tuple[str, str]], subprotocols: Iterable[str] = ()
) -> ClientConnection:
    """Connect.

    Raises:
        InvalidStatus: the upstream refused, with its status and body.
        OSError, TimeoutError, InvalidHandshake: nobody answers there, or not with a WebSocket.
    """
    offered = list(subprotocols)
    return await connect(
        url,
        additional_headers=passed_on(headers),
        user_agent_header=None,
        subprotocols=offered or None,  # type: ignore[arg-type]
        compression=None,  # it would cost time on every event
        max_size=MAX_BYTES,
        open_timeout=PATIENCE_S,
        ping_interval=PING_S,
        ping_timeout=PONG_S,
        logger=quiet_logger(),
    )
