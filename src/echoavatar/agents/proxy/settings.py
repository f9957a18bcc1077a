"""The settings of a proxy."""

from dataclasses import dataclass

from echoavatar.errors import EchoAvatarError


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
        scheme, _, rest = self.upstream.partition("://")
        if scheme not in ("ws", "wss") or not rest.strip("/"):
            raise EchoAvatarError(
                f"--upstream {self.upstream!r} is not a WebSocket URL; give one such as wss://api.openai.com/v1/realtime"
            )
