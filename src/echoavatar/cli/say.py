"""`echoavatar say`: send a sound file through a running server and record the motion."""

import argparse
import asyncio
import json
import logging
import time
from contextlib import AsyncExitStack, closing
from pathlib import Path

from echoavatar.errors import EchoAvatarError, one_line
from echoavatar.outgoing import redacted

from .batch import check_apart, readable_sound
from .options import add_manner, add_repeated, add_server, local_path, progress, seed
from .play import SINK_HELP

PATIENCE_S = 60.0  # time for the next second of motion
SPARE_S = 60.0  # most motion beyond the end of the sound
BYTES_A_SECOND = 200_000  # most motion and sound in memory; honest servers send half
LEAST_BYTES = 1_000  # counted for each message, and for each frame in it
EXAMPLES = """examples:
  echoavatar say talk.wav --server http://127.0.0.1:8765 -o talk.npz
  echoavatar say talk.wav --sink vmc://192.168.1.7    show the motion there, at the speed of playback
The last line is JSON: seconds of motion, of work and until the first motion, and bytes of motion."""

_LOG = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("audio", type=local_path, help="a file with sound, also a video; - is standard input")
    add_server(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="NPZ", help="write motion, face and sound to this file")
    parser.add_argument("--act", metavar="NAME", help="an action to perform at the beginning")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the motion (default: %(default)s)")
    add_manner(parser)
    add_repeated(parser, "--sink", "URL", SINK_HELP)
    parser.add_argument("--live", action="store_true", help="receive at the speed of playback, not as fast as possible")


def run(args: argparse.Namespace) -> int:
    """Send the file."""
    from echoavatar.files.exports.formats import SUFFIXES

    check_apart(args.output, sound=args.audio)
    if args.output and args.output.suffix.lower() in {".vrm", *SUFFIXES} - {".npz"}:
        raise EchoAvatarError(f"-o {args.output}: `say` writes .npz; `export` turns that into {args.output.suffix}")
    if args.output and not args.output.parent.is_dir():
        raise EchoAvatarError(f"folder {args.output.parent} does not exist; create it first")
    try:
        print(json.dumps(asyncio.run(_say(args))))
    except TimeoutError as error:
        raise EchoAvatarError(
            f"{redacted(args.server)} made no second of motion in {PATIENCE_S:g} s; look at its log, or try another"
        ) from error
    return 0


async def _say(args: argparse.Namespace) -> dict[str, float]:
    from echoavatar.agents.client import Recorder, connect
    from echoavatar.models.audio import read_audio
    from echoavatar.server.sinks import SinkGroup
    from echoavatar.timing import SAMPLE_RATE_HZ
    from echoavatar.wire.messages import ActionStatus, BodyOptions, Error, Motion, Sound

    is_live = args.live or bool(args.sink)
    with readable_sound(args.audio) as path:
        samples = read_audio(path)
    began, first, size = time.perf_counter(), 0.0, 0
    async with AsyncExitStack() as stack:
        names = ("liveliness", "handedness", "eye_contact", "feeling")
        body = BodyOptions(**{name: getattr(args, name) for name in names})
        avatar = await stack.enter_async_context(connect(args.server, token=args.token, seed=args.seed, body=body))
        recorder = Recorder(avatar.ready)
        shown = stack.enter_context(closing(SinkGroup(args.sink, avatar.ready.rig)))
        seconds = len(samples) / SAMPLE_RATE_HZ
        show = stack.enter_context(progress(total=seconds, unit="s", desc="motion"))
        wanted, left = 0, BYTES_A_SECOND * (seconds + SPARE_S)
        async with asyncio.timeout(PATIENCE_S) as patience:
            if args.act:
                await avatar.act(args.act)
            seg = await avatar.speak(samples)
            async for message in avatar:
                left -= LEAST_BYTES * (1 + getattr(message, "frames", 0)) + len(getattr(message, "pcm", b""))
                if left < 0:
                    raise EchoAvatarError(f"{redacted(args.server)} sends more than this sound needs; try another")
                recorder.take(message)
                if recorder.end >= wanted:
                    wanted = recorder.end + 24_000
                    patience.reschedule(asyncio.get_running_loop().time() + PATIENCE_S)
                shown.take(message)
                match message:
                    case Motion():
                        first = first or time.perf_counter() - began
                        size += len(message.rotations) + len(message.root) + len(message.face)
                        show(min(seconds, recorder.end / SAMPLE_RATE_HZ))
                    case Sound() if not is_live:
                        await avatar.played(avatar.received)
                    case ActionStatus(status="rejected"):
                        raise EchoAvatarError(message.reason)
                    case Error(fatal=True):
                        raise EchoAvatarError(message.message)
                    case Error():
                        _LOG.warning("the server says: %s", one_line(message.message))
                if recorder.has(seg):
                    break
        recording = recorder.recording(seg)
        await asyncio.to_thread(shown.finish)
    if args.output:
        recording.save(args.output)
        print(f"wrote {args.output}: {len(recording.root)} frames")
    return {
        "seconds": round(recording.seconds, 3),
        "work_seconds": round(time.perf_counter() - began, 3),
        "first_motion_seconds": round(first, 3),
        "motion_bytes": size,
    }
