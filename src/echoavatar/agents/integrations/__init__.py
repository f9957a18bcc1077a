"""What adapters of voice frameworks share. May import `server`, `client`, `timed_text`, `voice_formats` and below.

>>> bridge = AvatarBridge(find_backend("default"))  # or find_backend("http://127.0.0.1:8765")
>>> await bridge.start()
>>> await bridge.say(pcm, rate=16_000)
>>> async for event in bridge:  # chunks of motion and sound, when they are due
...     ...
"""

from .backend import AvatarBackend, find_backend
from .bridge import AvatarBridge
from .playback import AvatarChunk, Flushed, UtteranceDone
from .tools import AvatarTools

__all__ = ["AvatarBackend", "AvatarBridge", "AvatarChunk", "AvatarTools", "Flushed", "UtteranceDone", "find_backend"]
