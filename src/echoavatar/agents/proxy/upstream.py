"""The settings of a proxy, and its connection to the voice agent, with the client's own credentials and query."""

from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode, urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection

from echoavatar import outgoing
from echoavatar.errors import EchoAvatarError

from ..client.connection import open_websocket

MAX_BYTES = 1 << 24  # of one event; vendors allow up to 15 MiB
TIMEOUT_S = 15.0
HANDSHAKE_TIMEOUT_S = TIMEOUT_S + 5.0  # of a client's handshake, which waits for the upstream's
PING_S, PONG_S = 30.0, 120.0  # generous, because a slow reader answers pings late
_CONNECTION_HEADERS = {
    "connection",
    "content-length",
    "cookie",  # belongs to the proxy's host, not to the upstream
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
_HOST_HEADERS = {"alt-svc", "set-cookie", "strict-transport-security"}  # statements about the upstream's host


@dataclass(frozen=True)
class ProxySettings:
    """Where the voice comes from and where the avatar runs."""

    upstream: str  # such as wss://api.openai.com/v1/realtime
    avatar: str = ""  # address of an `echoavatar serve`; empty: relay only
    token: str = ""  # of the avatar's server
    tools: bool = False  # offer the avatar's tools to the model and carry out its calls
    idle: bool = True  # send motion between utterances as well
    origins: tuple[str, ...] = ()  # pages of other hosts that may connect

    def __post_init__(self) -> None:
        if outgoing.address_parts(self.upstream, "ws", "wss") is None:
            raise EchoAvatarError(
                f"--upstream {outgoing.redacted(self.upstream)!r} is not a WebSocket URL; "
                "give one such as wss://api.openai.com/v1/realtime"
            )


def upstream_url(upstream: str, path: str) -> str:
    """The upstream's URL with the query of the client's request; parameters of the client win."""
    parts = urlsplit(upstream)
    asked = parse_qsl(urlsplit(path).query, keep_blank_values=True)
    named = {key for key, _ in asked}
    own = [pair for pair in parse_qsl(parts.query, keep_blank_values=True) if pair[0] not in named]
    return urlunsplit((parts.scheme, parts.netloc, parts.path, urlencode(own + asked), ""))


def forwarded_headers(headers: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """The client's headers without those that belong to its own connection."""
    return [
        (name, value)
        for name, value in headers
        if name.lower() not in _CONNECTION_HEADERS and not name.lower().startswith("sec-websocket-")
    ]


def refusal_headers(headers: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """The headers of an upstream's refusal without those about its connection or its host."""
    return [pair for pair in headers if pair[0].lower() not in _CONNECTION_HEADERS | _HOST_HEADERS]


async def dial(url: str, headers: Iterable[tuple[str, str]], subprotocols: Iterable[str] = ()) -> ClientConnection:
    """Connect to the upstream.

    Raises:
        InvalidStatus: the upstream refused or redirects; the exception has its response.
        TimeoutError: the upstream does not answer.
        OSError, WebSocketException, DependencyError: no server answers there, or it is not a WebSocket server.
    """
    offered = list(subprotocols)
    try:
        return await open_websocket(
            url,
            additional_headers=forwarded_headers(headers),
            user_agent_header=None,
            subprotocols=offered or None,
            max_size=MAX_BYTES,
            open_timeout=TIMEOUT_S,
            ping_interval=PING_S,
            ping_timeout=PONG_S,
        )
    except TimeoutError as error:
        raise TimeoutError(f"the upstream did not answer within {TIMEOUT_S:g} s") from error
