"""What the owner of a proxy decides."""

from dataclasses import dataclass

from ..errors import EchoAvatarError


@dataclass(frozen=True)
class ProxySettings:
    """Where the voice comes from, and where the avatar lives."""

    upstream: str  # such as wss://api.openai.com/v1/realtime
    avatar: str = ""  # address of an `echoavatar serve`; empty: only relay
    token: str = ""  # of that server
    tools: bool = False  # offer the avatar's tools to the model, and do what it calls
    idle: bool = True  # motion between utterances too
    origins: tuple[str, ...] = ()  # pages of other hosts that may connect

    def __post_init__(self) -> None:
        scheme, _, rest = self.upstream.partition("://")
        if scheme not in ("ws", "wss") or not rest.strip("/"):
            raise EchoAvatarError(
                f"--upstream {self.upstream!r} is no WebSocket; give one such as wss://api.openai.com/v1/realtime"
            )
