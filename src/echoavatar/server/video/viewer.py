"""One WebRTC viewer of a session: its two tracks, and the connection that carries them."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from fractions import Fraction

import av

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire import ServerMessage

from ..outbox import Outbox
from ..session import ServerSession
from .live_stream import LiveStream, doubled
from .video_source import VideoSource

try:
    from aiortc import (
        MediaStreamTrack,
        RTCConfiguration,
        RTCIceServer,
        RTCPeerConnection,
        RTCRtpSender,
        RTCSessionDescription,
    )
    from aiortc.mediastreams import MediaStreamError
except ImportError as error:
    raise DependencyError("WebRTC needs aiortc; run: pip install 'echoavatar[video]'") from error

_LOG = logging.getLogger(__name__)
CODECS = ("video/vp8", "video/h264")  # the cheaper first
CONNECT_S = 20.0  # time for a viewer to connect after its answer
PICTURE_CLOCK_HZ = 90_000
NTP_EPOCH_S = 2_208_988_800  # 1970, in the seconds of reports, which count from 1900
_FRESH = ("new", "connecting")


class ViewerOutbox(Outbox):
    """Passes a session's messages to a video source at once. The session counts it as a client that plays."""

    def __init__(self, source: VideoSource, session: ServerSession, on_close: Callable[[], None]) -> None:
        super().__init__()
        self._source, self._session, self._on_close = source, session, on_close

    @property
    def plays(self) -> bool:
        """Only while the session has a source: a source that returns finds its session where it left it."""
        return self._session.source is not None

    def put(self, message: ServerMessage) -> None:
        """Pass a message on; nothing is queued."""
        self._source.take(message)

    def close(self) -> None:
        """The session is over."""
        super().close()
        self._on_close()


class _Track(MediaStreamTrack):  # type: ignore[misc]  # aiortc may be absent
    """A track whose sender tells the viewer when its packets are due.

    A player keeps picture and sound together by the sender's reports, which tie each track to a wall clock. aiortc
    reports when a packet left; that is late by the encoding, and on a busy machine by tenths of a second.
    """

    def __init__(self, stream: LiveStream) -> None:
        super().__init__()
        self.sender: RTCRtpSender | None = None
        self._stream = stream
        self._sent: float | None = None  # time of the stream of the newest frame

    def _report(self) -> None:
        """Called before the next frame, so all packets of the newest one have left."""
        if self.readyState != "live":
            raise MediaStreamError
        if self._sent is not None:
            ntp = round((self._stream.wall(self._sent) + NTP_EPOCH_S) * 2**32)
            setattr(self.sender, "_RTCRtpSender__ntp_timestamp", ntp)  # noqa: B010 (its name is private)


class SoundTrack(_Track):
    """The sound of a stream at 48 kHz."""

    kind = "audio"

    async def recv(self) -> av.AudioFrame:
        """The next 20 ms."""
        self._report()
        block = await self._stream.sound()
        self._sent = block.seconds
        frame = av.AudioFrame.from_ndarray(doubled(block.samples)[None], format="s16", layout="mono")
        frame.sample_rate = 2 * SAMPLE_RATE_HZ
        frame.pts, frame.time_base = round(block.seconds * frame.sample_rate), Fraction(1, frame.sample_rate)
        return frame


class PictureTrack(_Track):
    """The pictures of a stream."""

    kind = "video"

    async def recv(self) -> av.VideoFrame:
        """The next picture."""
        self._report()
        picture = await self._stream.picture()
        self._sent = picture.seconds
        frame = av.VideoFrame.from_ndarray(picture.pixels, format="rgb24")
        frame.pts, frame.time_base = round(picture.seconds * PICTURE_CLOCK_HZ), Fraction(1, PICTURE_CLOCK_HZ)
        return frame


class Viewer:
    """A peer connection that shows one session, from its offer until either side ends it."""

    def __init__(
        self, session: ServerSession, source: VideoSource, ice_servers: Sequence[str], on_end: Callable[[], None]
    ) -> None:
        """`ice_servers` are STUN or TURN addresses, such as `stun:stun.example.org`; most servers need none."""
        self.stream = LiveStream(source, lambda: session.place)
        self._session, self._on_end = session, on_end
        self._outbox = ViewerOutbox(source, session, self._leave)
        servers = [RTCIceServer(address) for address in ice_servers]
        self._peer = RTCPeerConnection(RTCConfiguration(iceServers=servers))  # without a list, aiortc asks Google's
        self._peer.on("connectionstatechange", self._check)
        self._ending: asyncio.Task[None] | None = None
        self._patience: asyncio.TimerHandle | None = None

    async def answer(self, offer: str) -> str:
        """The SDP answer to an SDP offer; from here on the viewer is served.

        Raises:
            EchoAvatarError: that is no offer of ours to serve.
        """
        try:
            await self._peer.setRemoteDescription(RTCSessionDescription(offer, "offer"))
            kinds = self._add_tracks()
            if "video" in kinds:
                await self._peer.setLocalDescription(await self._peer.createAnswer())
        except Exception as error:  # a parser of foreign text fails in many ways
            _LOG.info("an SDP offer was refused: %r", error)
            raise EchoAvatarError("this SDP offer cannot be answered; ask for VP8 or H.264, and Opus") from error
        if "video" not in kinds:
            raise EchoAvatarError("the SDP offer asks for no video; offer to receive video and audio")
        self._session.join(self._outbox, received=None)
        self._patience = asyncio.get_running_loop().call_later(CONNECT_S, self._give_up)
        return str(self._peer.localDescription.sdp)

    async def close(self) -> None:
        """End it; may be called twice."""
        self._leave()
        if self._ending is not None:
            await asyncio.shield(self._ending)

    # ---- inside

    def _add_tracks(self) -> set[str]:
        """Put a track into each medium that the viewer offers to receive; returns their kinds."""
        tracks: dict[str, _Track] = {"audio": SoundTrack(self.stream), "video": PictureTrack(self.stream)}
        known = RTCRtpSender.getCapabilities("video").codecs
        cheap = [codec for name in CODECS for codec in known if codec.mimeType.lower() == name]
        found = set[str]()
        for transceiver in self._peer.getTransceivers():
            track = tracks.pop(transceiver.kind, None)
            if track is None:
                continue
            transceiver.sender.replaceTrack(track)
            track.sender = transceiver.sender
            transceiver.direction = "sendonly"
            if transceiver.kind == "video":
                transceiver.setCodecPreferences(cheap)
            found.add(transceiver.kind)
        return found

    def _check(self) -> None:
        if self._peer.connectionState in ("failed", "closed"):
            self._leave()

    def _give_up(self) -> None:
        if self._peer.connectionState in _FRESH:
            self._leave()

    def _leave(self) -> None:
        """Begin to end it, once."""
        if self._ending is None:
            self._ending = asyncio.ensure_future(self._end())

    async def _end(self) -> None:
        self._session.leave(self._outbox)
        if self._patience is not None:
            self._patience.cancel()
        try:
            await self._peer.close()
        finally:
            await self.stream.close()
            self._on_end()
