"""An avatar for any voice agent that speaks the OpenAI Realtime protocol: only the URL changes.

`relay` forwards every event. `sidecar` lets an avatar of a running server listen in, and sends the motion it makes as
more events beside the voice. May import `client`, `timed_text`, `voice_formats`, `wire`, `timing`, `outgoing` and
below.
"""

from .relay import Relay
from .upstream import ProxySettings

__all__ = ["ProxySettings", "Relay"]
