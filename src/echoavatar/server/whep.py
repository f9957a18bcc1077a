"""WHEP (draft-ietf-wish-whep): a session as WebRTC video and sound, for any player that takes a URL.

POST an SDP offer to `/v1/sessions/NAME/whep` (or to `/v1/whep`: the newest session), get the answer and the address of
the viewer, DELETE that to end it. Each viewer has a renderer of its own; there are as many as the operator allows.
"""

import asyncio
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from importlib.resources import files
from pathlib import Path

import av
from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.files.avatar import CHARACTERS
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.files.avatar.framing import VIEWS
from echoavatar.server.video.live_stream import LiveStream, doubled
from echoavatar.server.video.offer import MOST_BYTES, read_offer
from echoavatar.server.video.video_source import VideoSource, prepare
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.guard import check_origin
from echoavatar.wire.rates import too_often

from .clients import client_of, refusal
from .outbox import Relay
from .page import file_answer
from .session import ServerSession
from .session_manager import SessionManager
from .tool_routes import answering, asked_session, read_body, readable_by_pages

_LOG = logging.getLogger(__name__)
CODECS = ("video/vp8", "video/h264")  # the cheaper first
CONNECT_S = 20.0  # time for a viewer to connect after its answer
PICTURE_CLOCK_HZ = 90_000
NTP_EPOCH_S = 2_208_988_800  # 1970, in the seconds of reports, which count from 1900
_FRESH = ("new", "connecting")
RETRY_S = 5
GRACE_S = 5.0  # to connect, before a viewer gives way to another client's


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
        self,
        session: ServerSession,
        source: VideoSource,
        ice_servers: Sequence[str],
        on_end: Callable[[], None],
        client: str = "",
    ) -> None:
        """`ice_servers` are STUN or TURN addresses, such as `stun:stun.example.org`; most servers need none."""
        self.client = client
        self._began = time.monotonic()
        self.stream = LiveStream(source, lambda: session.place)
        self._session, self._on_end = session, on_end
        self._outbox = Relay(source.take, lambda: session.source is not None, self._leave)
        servers = [RTCIceServer(address) for address in ice_servers]
        self._peer = RTCPeerConnection(RTCConfiguration(iceServers=servers))  # without a list, aiortc asks Google's
        self._peer.on("connectionstatechange", self._check)
        self._ending: asyncio.Task[None] | None = None
        self._patience: asyncio.TimerHandle | None = None

    @property
    def waits(self) -> bool:
        """Whether it has not connected yet."""
        return self._peer.connectionState in _FRESH

    @property
    def is_patient(self) -> bool:
        """Whether it has tried to connect for so long that it gives way to another client's viewer."""
        return self.waits and time.monotonic() - self._began > GRACE_S

    async def answer(self, offer: str) -> str:
        """The SDP answer to an SDP offer; from here on the viewer is served.

        Raises EchoAvatarError if the offer cannot be served.
        """
        try:
            await self._peer.setRemoteDescription(RTCSessionDescription(offer, "offer"))
            if "video" not in self._add_tracks():
                raise EchoAvatarError("the SDP offer asks for no video; offer to receive video and audio")
            await self._peer.setLocalDescription(await self._peer.createAnswer())
        except Exception as error:  # a parser of foreign text fails in many ways
            raise _unanswerable(error) from error
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
        if self.waits:
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
        except Exception as error:  # after a broken offer aiortc fails in many ways to close
            _LOG.info("a peer connection did not end well: %r", error)
        finally:
            await self.stream.close()
            self._on_end()


class VideoDesk:
    """All WebRTC viewers of a server."""

    def __init__(self, manager: SessionManager) -> None:
        """Reads and draws the first character, so that the first viewer does not wait for it."""
        self._manager, self._settings = manager, manager.settings
        self._viewers: dict[str, Viewer] = {}
        self._taken = 0  # renderers, also of viewers that are being answered or are ending
        manager.metrics.viewers.set_function(lambda: self._taken)
        self._worker = CapacityLimiter(1)  # reads offers and makes renderers, one after the other
        prepare(Shot(self._settings.video_size, renderer=self._settings.video_renderer))

    @property
    def free(self) -> int:
        """How many more viewers there can be."""
        return self._settings.video - self._taken

    async def close(self) -> None:
        """End all viewers."""
        for viewer in list(self._viewers.values()):
            await viewer.close()

    def routes(self) -> list[BaseRoute]:
        """The endpoint, its viewers, and the page that plays it."""
        cors = readable_by_pages(self._settings.origins, "POST", "DELETE")
        assets = Path(str(files("echoavatar"))) / "assets"
        begin, end = answering(self._manager, self._begin), answering(self._manager, self._end)
        return [
            Route("/v1/whep", begin, methods=["POST", "OPTIONS"], middleware=[cors]),
            Route("/v1/sessions/{session}/whep", begin, methods=["POST", "OPTIONS"], middleware=[cors]),
            Route("/v1/whep/{viewer}", end, methods=["DELETE", "OPTIONS"], middleware=[cors]),
            Route("/video", file_answer(assets / "video.html", "text/html")),
            Route("/video.js", file_answer(assets / "video.js", "text/javascript")),
        ]

    async def _begin(self, request: Request) -> Response:
        check_origin(request.headers, self._settings.origins)
        if "application/sdp" not in request.headers.get("content-type", ""):
            return refusal("send application/sdp", 415)
        session = asked_session(self._manager, request, dict(request.path_params))
        (character, shot), offer = self._wish(request), await read_body(request, MOST_BYTES)
        client = client_of(request.scope)
        if not (self.free or self._giving_way(client)):
            return refusal(f"all {self._settings.video} renderers are taken; try again later", 503, seconds=RETRY_S)
        await self._manager.clients.check("offers", client)
        given, host = offer.decode("utf-8", "replace"), request.client.host if request.client else ""
        try:
            text = await to_thread.run_sync(read_offer, given, host, limiter=self._worker)
        except Exception as error:  # a parser of foreign text fails in many ways
            raise _unanswerable(error) from error
        if not self.free and (viewer := self._giving_way(client)):
            await viewer.close()
        name, answer = await self._answer(session, character, shot, text, client)
        return Response(answer, 201, {"location": f"/v1/whep/{name}"}, "application/sdp")

    def _wish(self, request: Request) -> tuple[str, Shot]:
        """The character, and how it is pictured, as the query of an address asks."""
        query, settings = request.query_params, self._settings
        character, view = query.get("character", CHARACTERS[0]), query.get("view", VIEWS[0])
        if character.partition("/")[0] not in CHARACTERS:
            raise EchoAvatarError(f"there is no character {character[:40]!r}; choose from {', '.join(CHARACTERS)}")
        if view not in VIEWS:
            raise EchoAvatarError(f"there is no view {view[:40]!r}; choose from {', '.join(VIEWS)}")
        background = query.get("background", "studio")[:40]
        return character, Shot(settings.video_size, view, background, renderer=settings.video_renderer)

    def _giving_way(self, client: str) -> Viewer | None:
        """The viewer that ends if all renderers are taken and a client asks for one.

        It is the oldest one still connecting after `GRACE_S`; else the newest one of the client with most viewers, if
        that client has at least two more than the asking one. None gives way while the asking client has a viewer that
        is still connecting. So nobody can block others by offers that are never followed up, nor by many viewers.
        """
        viewers = list(self._viewers.values())
        if any(viewer.waits and viewer.client == client for viewer in viewers):
            return None
        if slow := next((viewer for viewer in viewers if viewer.is_patient), None):
            return slow
        shares = Counter(viewer.client for viewer in viewers)
        newest = max(reversed(viewers), key=lambda viewer: shares[viewer.client], default=None)
        return newest if newest is not None and shares[newest.client] > shares[client] + 1 else None

    async def _answer(
        self, session: ServerSession, character: str, shot: Shot, offer: str, client: str
    ) -> tuple[str, str]:
        """Seat a viewer; returns its name and the SDP answer."""
        if not self.free:
            raise too_often(f"all {self._settings.video} renderers are taken", RETRY_S)
        self._taken += 1
        try:
            make = partial(VideoSource, self._manager.rig, shot, character=character)
            source = await to_thread.run_sync(make, limiter=self._worker)
        except BaseException:
            self._taken -= 1
            raise
        name = secrets.token_urlsafe(16)
        viewer = Viewer(session, source, self._settings.ice_servers, lambda: self._free(name), client)
        self._viewers[name] = viewer
        try:
            return name, await viewer.answer(offer)
        except BaseException:
            await viewer.close()
            raise

    def _free(self, name: str) -> None:
        viewer = self._viewers.pop(name)
        self._taken -= 1
        pictures = self._manager.metrics.pictures
        pictures.labels("shown").inc(viewer.stream.shown)
        pictures.labels("skipped").inc(viewer.stream.skipped)

    async def _end(self, request: Request) -> Response:
        viewer = self._viewers.get(request.path_params["viewer"])
        if viewer is None:
            return refusal("there is no such viewer, or it has ended", 404)
        await viewer.close()
        return Response(status_code=200)


def _unanswerable(error: Exception) -> EchoAvatarError:
    if isinstance(error, EchoAvatarError):
        return error
    _LOG.info("an SDP offer was refused: %r", error)
    return EchoAvatarError("this SDP offer cannot be answered; ask for VP8 or H.264, and Opus")
