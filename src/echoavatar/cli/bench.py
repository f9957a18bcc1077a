"""`echoavatar bench`: latency, real-time factor, memory. Prints a table, then one line of JSON."""

import argparse
import json
import os
import statistics
from contextlib import suppress
from typing import TYPE_CHECKING

from echoavatar.errors import DependencyError, EchoAvatarError

from . import command_module
from .options import add_model, add_pipeline, progress

if TYPE_CHECKING:
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.models.generator.config import Precision

DEVELOPERS = {
    "neighbours": "how late an honest speaker is beside clients that misbehave",
    "post": "smoothing, root, feet and hands",
    "soak": "does a server survive load and faults without growing in memory",
    "train": "training steps against the machine's matrix rate",
}  # with echoavatar-lab


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    stream = kinds.add_parser(
        "stream",
        help="one session, stage by stage",
        description="Time every stage of the streaming pipeline, chunk by chunk (default bundle: 133 ms of audio).",
        epilog="example: echoavatar bench stream --seconds 3600   (a simulated hour: does memory stay constant?)",
    )
    _models(stream)
    stream.add_argument("--seconds", type=float, default=60.0, help="length of the audio (default: %(default)s)")
    stream.add_argument("--sessions", type=int, default=1, help="sessions in the batch (default: %(default)s)")
    stream.add_argument(
        "--precision",
        choices=("float32", "bfloat16", "int8"),
        help="precision of the generator's weights (default: int8 on a CPU, bfloat16 on a GPU, as everywhere)",
    )
    face = kinds.add_parser(
        "face", help="the face model", description="Time the face model for one session and for a batch."
    )
    add_model(face)
    face.add_argument("--chunks", type=int, default=200, help="chunks to time (default: %(default)s)")
    face.add_argument("--sessions", type=int, default=64, help="sessions in the batch (default: %(default)s)")
    many = kinds.add_parser(
        "sessions",
        help="how many sessions are served in real time",
        description="Open 1, 2, 4 ... sessions; time audio to motion in those that the machine has room for.",
    )
    many.epilog = "example: echoavatar bench sessions --size paper --device cuda --counts 16,32,64"
    _models(many)
    many.add_argument(
        "--counts", type=_counts, default="1,2,4,6,8,10,12,16", help="numbers of sessions to try (default: %(default)s)"
    )
    many.add_argument("--seconds", type=float, default=8.0, help="length of each session (default: %(default)s)")
    many.add_argument("--neighbours", action="store_true", help="also beside a session that floods, stalls or vanishes")

    proxy = kinds.add_parser(
        "proxy",
        help="latency that an avatar adds to a voice agent",
        description="Time events sent directly, through a plain relay and through the proxy, in one run.",
    )
    proxy.add_argument("--seconds", type=float, default=60.0, help="length of the speech (default: %(default)s)")
    add_model(proxy, "bundle of the avatar")
    proxy.add_argument("--avatar", metavar="URL", help="a running server instead of a new one")

    start = kinds.add_parser(
        "start",
        help="from the command to the first motion",
        description="Time fresh processes until an avatar answers: imports, loading, warm-up, five seconds of sound.",
    )
    add_model(start)
    start.add_argument("--runs", type=int, default=4, help="processes to time, one by one (default: %(default)s)")
    for kind, summary in DEVELOPERS.items():
        child = kinds.add_parser(kind, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter)
        with suppress(DependencyError):
            command_module(f"bench {kind}").add_arguments(child)


def _models(parser: argparse.ArgumentParser) -> None:
    add_pipeline(parser)
    parser.add_argument(
        "--size",
        choices=("bundle", "paper"),
        default="bundle",
        help="'paper' swaps in the 0.5B generator with random weights, to time it (default: %(default)s)",
    )
    parser.add_argument(
        "--sequence",
        choices=("prefix", "interleaved", "depth"),
        default="prefix",
        help="token order of this generator; prefix: the paper's, prefills its window at every step; interleaved: "
        "only new tokens; depth: the 0.5B reads frames, 4 layers of 384 draw codes (default: %(default)s)",
    )
    parser.add_argument("--threads", type=int, help="threads that compute (default: as many as processors)")


def _pipeline(args: argparse.Namespace, precision: "Precision | None" = None) -> "Pipeline":
    """The pipeline that the arguments of `_models` ask for."""
    if args.threads:
        os.environ["OMP_NUM_THREADS"] = str(args.threads)  # torch reads it when it is imported

    from echoavatar.engine.pipeline import Pipeline, load_bundle
    from echoavatar.engine.pipeline.bundle import with_random_generator

    bundle = load_bundle(args.model).running(args.runtime).without(args.without)
    print(f"runtime: {bundle.runtime.label}")
    chosen = with_random_generator(bundle, args.sequence) if args.size == "paper" else bundle
    return Pipeline(chosen, precision=precision, device=args.device)


def _counts(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers of sessions from 1 on, such as 1,2,4")
    return tuple(map(int, parts))


def _stream(args: argparse.Namespace) -> int:
    from echoavatar.bench.stream import bench_stream

    pipeline = _pipeline(args, args.precision)
    with progress(unit="chunk") as show:
        report = bench_stream(pipeline, seconds=args.seconds, sessions=args.sessions, progress=show)
    print(f"{'stage':<14}{'p50 ms':>10}{'p95 ms':>10}{'p99 ms':>10}")
    for stage, values in report.stages_ms.items():
        print(f"{stage:<14}" + "".join(f"{value:>10.2f}" for value in values))
    verdict = "" if report.summary["rtf"] < 1 else " (not real time)"
    print(f"real-time factor {report.summary['rtf']:.3f} with {report.summary['threads']:.0f} threads{verdict}")
    print(json.dumps(report.summary))
    return 0


def _sessions(args: argparse.Namespace) -> int:
    from echoavatar.bench.sessions import bench_neighbour, bench_sessions, summary

    pipeline = _pipeline(args)
    with progress(unit="load", leave=False) as show:
        loads = bench_sessions(pipeline, args.counts, seconds=args.seconds, progress=show)
    print(f"{'came':<6}{'admitted':>10}{'p50 ms':>10}{'p99 ms':>10}{'late':>6}{'busy':>8}{'MB each':>10}  in real time")
    for load in loads:
        numbers = f"{load.p50_ms:>10.1f}{load.p99_ms:>10.1f}{load.late:>6}{load.busy:>8.2f}{load.memory_mb:>10.2f}"
        print(f"{load.sessions:<6}{load.admitted:>10}{numbers}  {'yes' if load.in_real_time else 'no'}")
    report = summary(loads)
    if args.neighbours:
        report["p99_ms_beside"] = bench_neighbour(pipeline, seconds=args.seconds)
    print(json.dumps(report))
    return 0


def _proxy(args: argparse.Namespace) -> int:
    from contextlib import ExitStack

    from echoavatar.agents.proxy.bench import bench_proxy

    from .proxy import own_server

    with ExitStack() as stack:
        avatar = args.avatar or stack.enter_context(own_server(args.model, 1, ""))
        report = bench_proxy(avatar, seconds=args.seconds)
    print(f"{'route':<10}{'p50 ms':>10}{'p95 ms':>10}{'p99 ms':>10}{'most ms':>10}{'events':>10}")
    for name, route in report.routes.items():
        times = "".join(f"{value:>10.2f}" for value in route[:4])
        print(f"{name:<10}{times}{route.events:>10}")
    print(f"{report.frames} of {report.expected_frames} frames of motion came beside the voice")
    verdict = "under" if report.added_p99_ms < 5 else "NOT under"
    print(f"the avatar adds {report.added_p99_ms:.2f} ms (p99) to a plain relay: {verdict} 5 ms")
    print(json.dumps(report.summary))
    return 0


def _face(args: argparse.Namespace) -> int:
    from echoavatar.bench.face import bench_face
    from echoavatar.engine.pipeline import Pipeline, load_bundle

    face = Pipeline(load_bundle(args.model)).face
    if face is None:
        raise EchoAvatarError(f"bundle {args.model} has no face; train one (`echoavatar train face`)")
    report = bench_face(face, chunks=args.chunks, sessions=args.sessions)
    for key, value in report.items():
        print(f"{key:<20}{value:>10.3f}")
    print(json.dumps(report))
    return 0


def _start(args: argparse.Namespace) -> int:
    from echoavatar.bench.start import bench_start

    with progress(total=args.runs, unit="start", leave=False) as show:
        report = bench_start(args.model, runs=args.runs, progress=show)
    print(f"{'s':<10}{'first':>8}{'warm':>8}{'least':>8}")
    for name, values in (report.phases | {"animate": report.animate, "--help": report.help}).items():
        print(f"{name:<10}{values[0]:>8.2f}{statistics.median(values[1:]):>8.2f}{min(values):>8.2f}")
    print(f"loops compiled in each run: {' '.join(map(str, report.compiled))}")
    print(json.dumps(report.summary))
    return 0


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.kind in DEVELOPERS:
        return int(command_module(f"bench {args.kind}").run(args))
    return {"stream": _stream, "face": _face, "sessions": _sessions, "proxy": _proxy, "start": _start}[args.kind](args)
