"""An avatar behind any voice agent that speaks the OpenAI Realtime protocol: change one URL. No torch.

`relay` passes every event through, `link` lets an avatar of a running server listen in, and what it makes comes as
further events beside the voice. May import `client`, `wire`, `timing` and `errors`.
"""

from .relay import Relay
from .settings import ProxySettings

__all__ = ["ProxySettings", "Relay"]
