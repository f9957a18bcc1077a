"""`echoavatar bench soak`: checks that a server stays whole under load and faults."""

import argparse
import json
from pathlib import Path

from tqdm import tqdm

from echoavatar.cli.options import add_model


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = (
        "Serve sessions and a coming and going visitor from a process of its own; check that nothing is missing, "
        "doubled or stale, and that memory stays flat. Fails if something is. Linux only."
    )
    parser.epilog = "example: echoavatar bench soak --sessions 4 --minutes 60 --faults --picture soak.png"
    add_model(parser)
    parser.add_argument("--sessions", type=int, default=4, help="speaking sessions (default: %(default)s)")
    parser.add_argument(
        "--visitors", type=int, default=1, help="visitors, which come, speak and leave (default: %(default)s)"
    )
    parser.add_argument("--minutes", type=float, default=5.0, help="length (default: %(default)s)")
    parser.add_argument(
        "--faults", action="store_true", help="clients drop, stall, flood and vanish; the engine breaks once a minute"
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw memory over time")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    from echoavatar_lab.bench.soak import bench_soak, draw

    with tqdm(total=args.minutes, unit="min", leave=False, disable=None) as bar:
        report = bench_soak(
            args.model,
            sessions=args.sessions,
            visitors=args.visitors,
            minutes=args.minutes,
            faults=args.faults,
            progress=lambda minutes: bar.update(minutes - bar.n) and None,
        )
    if args.picture:
        draw(report, args.picture)
    is_whole = not any(report[name] for name in ("stale", "doubled", "missing"))
    is_whole = is_whole and report["lost"] <= report["failed_by_us"]
    for name, value in report.items():
        if name != "memory_mb":
            print(f"{name:<20}{value}")
    print(f"the sessions {'stayed whole' if is_whole else 'did NOT stay whole'}")
    print(json.dumps(report))
    return 0 if is_whole else 1
