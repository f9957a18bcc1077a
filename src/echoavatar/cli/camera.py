"""`echoavatar camera`: a running server's avatar as a camera of this machine, or to an RTMP server or a file."""

import argparse
import asyncio
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from echoavatar.errors import EchoAvatarError
from echoavatar.outgoing import redacted

from .options import VIEWS, add_picture, add_server, size

if TYPE_CHECKING:
    from echoavatar.engine import Playhead
    from echoavatar.server.video import LiveStream, VideoSource
    from echoavatar.server.video.broadcast import Broadcast, VirtualCamera
    from echoavatar.wire.messages import Ready

RATE_HZ = 25
RETRY_S = 2.0
EXAMPLES = """examples:
  echoavatar serve                             in one terminal: open its page, and talk or play music there
  echoavatar camera                            in another: choose the new camera in Zoom, Teams or OBS
  echoavatar camera --view bust --background '#00ff00'   head and shoulders on green, to be keyed out
  echoavatar camera --to rtmp://a.rtmp.youtube.com/live2/KEY   picture and sound to a streaming service
  echoavatar camera --to talk.flv --seconds 60 record a minute of what is seen and heard

It draws here; the server needs no --video. A virtual camera carries no sound: share that of the page.
Linux needs v4l2loopback, Windows and macOS the virtual camera of OBS. More: docs/video.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_server(parser)
    parser.add_argument("--session", default="", metavar="NAME", help="the session to show (default: the newest)")
    parser.add_argument("--to", metavar="WHERE", help="rtmp://HOST/APP/KEY, or a file: .flv, .mp4, .mkv, .ts")
    parser.add_argument("--view", choices=VIEWS, default=VIEWS[0], help="what the picture shows (default: %(default)s)")
    parser.add_argument("--size", type=size, default=(1280, 720), metavar="WxH", help="pixels (default: 1280x720)")
    add_picture(parser)
    parser.add_argument("--seconds", type=float, metavar="N", help="stop after so long (default: Ctrl-C)")


def run(args: argparse.Namespace) -> int:
    """Show sessions until stopped."""
    from echoavatar.files.avatar.avatar_renderer import RENDERERS
    from echoavatar.server.video.broadcast import Broadcast, VirtualCamera, container_of

    width, height = args.size
    if not (64 <= width <= 3840 and 64 <= height <= 2160):
        raise EchoAvatarError(f"--size {width}x{height} is not between 64x64 and 3840x2160")
    RENDERERS[args.renderer](8, 8, background=args.background)  # fails now if something is missing
    if args.to:
        container_of(args.to)
    output: Broadcast | VirtualCamera = (
        Broadcast(args.to, args.size, RATE_HZ) if args.to else VirtualCamera(args.size, RATE_HZ)
    )
    print(f"showing the avatar of {redacted(args.server)} at {output.name}; Ctrl-C stops", flush=True)
    try:
        with suppress(KeyboardInterrupt):
            asyncio.run(_Show(args, output).run())
    finally:
        output.close()
    return 0


class _Show:
    """One output, and the sessions that it shows one after another."""

    def __init__(self, args: argparse.Namespace, output: "Broadcast | VirtualCamera") -> None:
        self._args, self._output = args, output
        self._lock = asyncio.Lock()  # an output is not thread-safe
        self._source: VideoSource | None = None
        self._playhead: Playhead
        self._stream: LiveStream
        self._is_waiting = False
        self._is_there = asyncio.Event()  # the first session

    async def run(self) -> None:
        """Run until cancelled, or for `--seconds` from the first picture."""
        watching, there = (asyncio.ensure_future(each) for each in (self._watch(), self._is_there.wait()))
        await asyncio.wait([watching, there], return_when=asyncio.FIRST_COMPLETED)
        if watching.done():
            watching.result()
        stream, output = self._stream, self._output
        pairs = ((stream.picture, output.show), (stream.sound, output.hear))
        work = [watching, *(asyncio.ensure_future(self._pass_on(take, show)) for take, show in pairs)]
        try:
            done, _ = await asyncio.wait(work, timeout=self._args.seconds, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._output.stop()  # otherwise a call that hangs in its thread delays the end
            for task in work:
                task.cancel()
            await asyncio.gather(*work, return_exceptions=True)
            await self._stream.close()
        print(f"{self._stream.shown} pictures, {self._stream.skipped} left out", file=sys.stderr)

    async def _pass_on(self, take: Callable[[], Awaitable[Any]], show: Callable[[Any], None]) -> None:
        while True:
            taken = await take()
            async with self._lock:
                await asyncio.to_thread(show, taken)

    async def _watch(self) -> None:
        """Take the messages of one session after another."""
        from echoavatar.agents.client import ConnectionLostError, RemoteTools, connect
        from echoavatar.wire.codec import ProtocolError
        from echoavatar.wire.messages import Flush

        args, tools = self._args, RemoteTools(self._args.server, token=self._args.token)
        while True:
            names = [args.session] if args.session else await asyncio.to_thread(tools.sessions)
            try:
                if names:
                    async with connect(args.server, token=args.token, watch=names[-1]) as avatar:
                        source = await self._begin(avatar.ready)
                        async for message in avatar:
                            source.take(message)
                            if isinstance(message, Flush):
                                self._playhead.jump(min(message.at, self._playhead.sample))
            except ConnectionLostError:
                pass
            except ProtocolError as error:
                if error.code != "unknown_session":
                    raise
            if not self._is_waiting:
                self._is_waiting = True
                print(
                    "no session there; waiting for one (open the server's page, or `echoavatar say`)", file=sys.stderr
                )
            await asyncio.sleep(RETRY_S)

    async def _begin(self, ready: "Ready") -> "VideoSource":
        """Show a session from its present moment on."""
        from echoavatar.engine import Playhead
        from echoavatar.files.avatar.avatar_renderer import Shot
        from echoavatar.server.video import LiveStream, VideoSource
        from echoavatar.wire.messages import Flush

        args, self._is_waiting = self._args, False
        self._playhead = Playhead()
        self._playhead.jump(ready.at)
        if self._source is not None:
            self._source.take(Flush(at=0, epoch=0, seg=0, heard=0))
            return self._source
        shot = Shot(args.size, args.view, args.background, renderer=args.renderer)
        source = await asyncio.to_thread(VideoSource, ready.rig, shot, character=args.character)
        self._stream = LiveStream(source, self._heard, rate=RATE_HZ)
        self._source = source
        self._is_there.set()
        return source

    def _heard(self) -> int:
        """The sample that is heard now, by the wall clock, because a viewer gets no reports of playback."""
        assert self._source is not None
        self._playhead.advance(time.monotonic(), self._source.end)
        return self._playhead.sample
