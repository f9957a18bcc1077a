"""`echoavatar serve`: the live server for browsers and voice agents."""

import argparse
import os
import re
import sys
import webbrowser
from pathlib import Path
from threading import Thread

from echoavatar.errors import EchoAvatarError

from . import command_module
from .options import RENDERER_HELP, RENDERER_NAMES, TOKEN, add_pipeline, add_repeated, choose_token

SINK_HELP = (
    "also show the avatar elsewhere: vmc://HOST[:PORT], livelink://HOST[:PORT], json://HOST[:PORT], or unity://HOST[:PORT]"
    " for a Unity project of the paper's authors, which needs an imported bundle and no other sink"
)

VIDEO_HELP = (
    "serve sessions as WebRTC video and sound (WHEP), drawn here, to at most this many viewers at once; without a "
    "number, one for every two processors. Each viewer takes most of a processor (docs/video.md)"
)

EXAMPLES = """examples:
  echoavatar serve                             for this machine only; open the address that it prints
  echoavatar serve --host 0.0.0.0 --seats 8    for the network too; clients need a token
  echoavatar serve --sink vmc://127.0.0.1      also show it in VSeeFace, Warudo, Unity, Unreal or Blender
  echoavatar serve --video                     also as WebRTC video: /video shows it, any WHEP player can
  echoavatar serve --model reference --sink unity://192.168.1.7
                                               one session for a Unity project of the paper's authors
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_pipeline(parser)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8765, help="port; 0: any free one (default: %(default)s)")
    parser.add_argument(
        "--seats",
        type=int,
        default=16,
        help="most sessions at the same time; fewer if the machine carries fewer in real time (default: %(default)s)",
    )
    parser.add_argument(
        "--token",
        help=f"token that clients must send; default: ${TOKEN}, else none on this machine, a random one on a network",
    )
    add_repeated(parser, "--origin", "URL", "let pages of this host connect, such as https://avatar.example.org")
    add_repeated(parser, "--proxy", "ADDRESS", "address or network of a proxy whose X-Forwarded-For is believed")
    parser.add_argument("--music", type=Path, metavar="FOLDER", help="folder with more tracks for play_music")
    parser.add_argument(
        "--ahead",
        type=float,
        default=2.0,
        metavar="SECONDS",
        help="how far ahead of playback motion may be made, 0.3 to 3.5 (default: %(default)s)",
    )
    parser.add_argument(
        "--drain",
        type=float,
        default=10.0,
        metavar="SECONDS",
        help="time for sessions to finish when the server is stopped (default: %(default)s)",
    )
    parser.add_argument("--threads", type=int, help="threads that compute (default: as many as processors)")
    parser.add_argument(
        "--log", choices=("text", "json"), default="text", help="form of log lines (default: %(default)s)"
    )
    parser.add_argument(
        "--traces",
        metavar="URL",
        help="send OpenTelemetry traces of every chunk to this OTLP collector, such as http://127.0.0.1:4318/v1/traces",
    )
    parser.add_argument("--certificate", "--tls-cert", metavar="PEM", help="TLS certificate, with --key: https and wss")
    parser.add_argument("--key", "--tls-key", metavar="PEM", help="private key of --certificate, without a password")
    add_repeated(parser, "--sink", "URL", SINK_HELP)
    parser.add_argument("--audio-port", type=int, default=12345, help="unity://: port for audio (default: %(default)s)")
    parser.add_argument(
        "--action-port",
        type=int,
        default=12347,
        help="with unity://, port for action names; 12346 in the release (default: %(default)s)",
    )
    parser.add_argument("--video", nargs="?", type=int, const=-1, default=0, metavar="VIEWERS", help=VIDEO_HELP)
    parser.add_argument(
        "--video-size", type=int, default=512, metavar="PIXELS", help="width and height, even (default: %(default)s)"
    )
    parser.add_argument("--video-renderer", choices=RENDERER_NAMES, default=RENDERER_NAMES[0], help=RENDERER_HELP)
    ice = "STUN or TURN server for video viewers behind routers, such as stun:stun.example.org"
    add_repeated(parser, "--ice", "URL", ice)
    parser.add_argument("--open", action="store_true", help="open the page in the browser")


def run(args: argparse.Namespace) -> int:
    """Load the bundle and serve until stopped."""
    if legacy := [text for text in args.sink if text.startswith("unity:")]:
        if len(args.sink) > 1:
            raise EchoAvatarError(f"--sink {legacy[0]} excludes other sinks; leave them out")
        return int(command_module("serve unity").run(args))
    from echoavatar.engine import load
    from echoavatar.server import ServerSettings, create_app, serve
    from echoavatar.server.companion import who_talks
    from echoavatar.server.run import log_json
    from echoavatar.wire.guard import is_loopback

    _check(args)
    tracer = None
    if args.traces:
        from echoavatar.server.tracing import export_to

        tracer = export_to(args.traces)
    if args.log == "json":
        log_json()
    if args.threads:
        os.environ["OMP_NUM_THREADS"] = str(args.threads)
    token, is_made_up = choose_token(args.token, args.host)
    settings = ServerSettings(
        token=token,
        origins=tuple(origin.rstrip("/") for origin in args.origin),
        proxies=tuple(args.proxy),
        music=args.music,
        ahead_seconds=args.ahead,
        drain_seconds=args.drain,
        sinks=tuple(args.sink),
        video=_viewers(args.video),
        video_size=(args.video_size, args.video_size),
        video_renderer=args.video_renderer,
        ice_servers=tuple(args.ice),
        tracer=tracer,
        lists_sessions=is_loopback(args.host),
    )
    engine = load(args.model, seats=args.seats, device=args.device, without=args.without, runtime=args.runtime)
    engine.measure()
    app = create_app(engine, settings)

    def ready(address: str) -> None:
        page = f"{address}/?token={token}" if token else f"{address}/"
        shown = page if is_made_up else f"{address}/"  # a token of the operator's own belongs in no log
        print(
            f"echoavatar is at {shown}  (room for {engine.room}; runtime: {engine.pipeline.runtime}; Ctrl-C stops)",
            flush=True,
        )
        if settings.video:
            print(f"video for {settings.video} at a time: {address}/video, WHEP at {address}/v1/whep", flush=True)
        Thread(target=tell_who_talks, daemon=True).start()
        if args.open:
            webbrowser.open(page)

    def tell_who_talks() -> None:
        """Load the voices while the page loads."""
        try:
            print(who_talks(app.state.manager), flush=True)
        except EchoAvatarError as error:
            print(f"the chat does not work: {error}", file=sys.stderr, flush=True)

    serve(app, host=args.host, port=args.port, on_ready=ready, ssl_certfile=args.certificate, ssl_keyfile=args.key)
    print("echoavatar: stopped", file=sys.stderr)
    return 0


def _viewers(asked: int) -> int:
    """The largest number of video viewers; `asked` is -1 for as many as the processors can draw."""
    if not asked:
        return 0
    import aiortc  # noqa: F401  # an absent package is reported before the bundle is loaded

    return max(1, (os.cpu_count() or 2) // 2) if asked < 0 else asked


def _check(args: argparse.Namespace) -> None:
    from echoavatar.server.sinks import check_address
    from echoavatar.wire.guard import check_certificate

    for text in args.sink:
        check_address(text)
    if args.video < -1:
        raise EchoAvatarError(f"--video {args.video} is no number of viewers; give 1 or more")
    if not 64 <= args.video_size <= 1080 or args.video_size % 2:
        raise EchoAvatarError(f"--video-size {args.video_size} is not an even number from 64 to 1080")
    for server in args.ice:
        if not re.match(r"(stun|turn)s?:[^/]", server):
            raise EchoAvatarError(f"--ice {server} is no STUN or TURN server; give one such as stun:stun.example.org")
    if not 0.3 <= args.ahead <= 3.5:
        raise EchoAvatarError(f"--ahead {args.ahead:g} is not between 0.3 and 3.5; the engine can take back 4 s")
    if bool(args.certificate) != bool(args.key):
        raise EchoAvatarError("--certificate and --key go together; give both or neither")
    if args.certificate:
        check_certificate(args.certificate, args.key)
