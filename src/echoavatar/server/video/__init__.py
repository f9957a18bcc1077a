"""Live video of a session, for programs that cannot draw the avatar: pictures and sound on one clock.

May import `sinks`, `files`, `wire` and below. `VideoSource` knows what a session looks and sounds like at any moment of
its clock. `LiveStream` reads it in wall time, each picture and block of sound just before it is due. `broadcast` shows
the stream through a virtual camera, a file or an RTMP server; `server.whep` through WebRTC.
"""

from .live_stream import Block, LiveStream, Picture
from .video_source import VideoSource

__all__ = ["Block", "LiveStream", "Picture", "VideoSource"]
