"""`echoavatar bench`: latency, real-time factor, memory. A table for people, then one line of JSON."""

import argparse
import json
import sys

from tqdm import tqdm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    stream = kinds.add_parser(
        "stream",
        help="one stream, stage by stage",
        description="Time every stage of the streaming pipeline, chunk by chunk (a chunk is 266.7 ms of sound).",
        epilog="example: echoavatar bench stream --seconds 3600   (a simulated hour: is memory flat?)",
    )
    stream.add_argument("--model", default="default", help="bundle name or folder (default: %(default)s)")
    stream.add_argument(
        "--size",
        choices=("bundle", "paper"),
        default="bundle",
        help="'paper' swaps in the 0.5B generator with random weights, to time it (default: %(default)s)",
    )
    stream.add_argument("--seconds", type=float, default=60.0, help="sound to push (default: %(default)s)")
    stream.add_argument("--sessions", type=int, default=1, help="seats in the batch (default: %(default)s)")
    stream.add_argument("--threads", type=int, help="torch threads (default: torch's own choice)")
    stream.add_argument(
        "--precision",
        choices=("float32", "bfloat16", "int8"),
        default="int8",
        help="of the generator's weights (default: %(default)s, as everywhere)",
    )


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    import torch

    from ..evaluation.stream_bench import bench_stream
    from ..pipeline import Pipeline, load_bundle
    from ..pipeline.bundle import with_random_generator

    if args.threads:
        torch.set_num_threads(args.threads)
    bundle = load_bundle(args.model)
    if args.size == "paper":
        bundle = with_random_generator(bundle)
    pipeline = Pipeline(bundle, precision=args.precision)
    with tqdm(unit="chunk", disable=not sys.stderr.isatty()) as bar:
        report = bench_stream(
            pipeline,
            seconds=args.seconds,
            sessions=args.sessions,
            progress=lambda done, _: bar.update(done - bar.n),
        )
    print(f"{'stage':<14}{'p50 ms':>10}{'p95 ms':>10}{'p99 ms':>10}")
    for stage, values in report.stages_ms.items():
        print(f"{stage:<14}" + "".join(f"{value:>10.2f}" for value in values))
    print(f"real-time factor {report.summary['rtf']:.3f} with {report.summary['threads']:.0f} threads")
    print(json.dumps(report.summary))
    return 0
