"""`echoavatar bench graphs`: a bundle's live step on a GPU."""

import argparse
import json

from echoavatar.cli.options import RUNTIME_HELP


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = (
        "Time encoder, generator, decoder and rig of the live step, beside the paper's table. With --device cuda "
        "the generator's step is a captured graph; on a CPU it is not."
    )
    parser.add_argument("--model", required=True, help="bundle name or folder")
    parser.add_argument("--device", default="cuda", help="cuda, or cpu to try it (default: %(default)s)")
    parser.add_argument("--runtime", default="default", metavar="HOW", help=RUNTIME_HELP)
    parser.add_argument("--chunks", type=int, default=100, help="chunks to time (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar_lab.bench.graphs import GOALS_MS, PAPER_MS, bench_graphs

    bundle = load_bundle(args.model).running(args.runtime)
    print(f"runtime: {bundle.runtime.label}")
    report = bench_graphs(bundle, device=args.device, chunks=args.chunks)
    print(f"{'stage':<12}{'p50 ms':>10}{'p95 ms':>10}{'goal ms':>10}{'paper ms':>10}")
    for stage, (p50, p95) in report.stages_ms.items():
        print(f"{stage:<12}{p50:>10.2f}{p95:>10.2f}{GOALS_MS[stage]:>10.1f}{PAPER_MS[stage]:>10.1f}")
    how = "captured as a graph" if report.is_captured else "not captured: plain calls, not real time"
    print(f"{report.device}, {how}; a chunk is {report.chunk_ms:.1f} ms of sound")
    print(json.dumps({stage: values[0] for stage, values in report.stages_ms.items()}))
    return 0
