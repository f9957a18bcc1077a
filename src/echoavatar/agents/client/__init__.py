"""Speak to a server from Python. May import `wire`, `timing`, `outgoing` and below.

>>> async with connect("http://127.0.0.1:8765") as avatar:
...     await avatar.speak(samples, rate=24_000)
...     async for message in avatar:
...         ...
"""

from .connection import Avatar, ConnectionLostError, connect, stream_url
from .recording import Recorder, Recording
from .tools import RemoteTools

__all__ = ["Avatar", "ConnectionLostError", "Recorder", "Recording", "RemoteTools", "connect", "stream_url"]
