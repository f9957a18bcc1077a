"""`echoavatar bench post`: how long the stages behind the decoder take, without a model."""

import argparse
import json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = (
        "Time what follows the decoder, stage by stage, for one session and for a batch, without a model."
    )
    parser.add_argument("--chunks", type=int, default=600, help="chunks to time (default: %(default)s)")
    parser.add_argument("--sessions", type=int, default=64, help="sessions in the batch (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    import torch

    from echoavatar_lab.bench.post import bench_post

    torch.set_num_threads(1)  # the stages use no more
    report = bench_post(chunks=args.chunks, sessions=args.sessions)
    print(f"{'ms a chunk':<12}{'1 session':>12}{f'each of {args.sessions}':>14}")
    for stage, one in report.one_ms.items():
        print(f"{stage:<12}{one:>12.3f}{report.many_ms[stage]:>14.3f}")
    print(json.dumps(report.summary))
    return 0
