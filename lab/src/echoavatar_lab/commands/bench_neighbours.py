"""`echoavatar bench neighbours`: does an honest speaker notice that another client misbehaves."""

import argparse
import json
import os
from typing import Any

from echoavatar.cli.options import TOKEN, add_model

ROW = "| {:<28} | {:<26} | {:>8} | {:>8} | {:>9} |"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = (
        "Speak in real time at a server of our own beside one neighbour after the other, and measure how late sound "
        "and motion come. Fails if a chunk is more than 0.3 s late. Rows with WebRTC need aiortc; TLS needs openssl."
    )
    parser.epilog = "example: echoavatar bench neighbours --only nobody --only 'token guesses'"
    add_model(parser)
    parser.add_argument(
        "--server",
        action="append",
        default=[],
        metavar="URL",
        help=f"measure this running server, ws:// or wss://, with the token ${TOKEN}; repeat to compare",
    )
    parser.add_argument("--certificate", default="", metavar="PEM", help="to be trusted, for wss://")
    parser.add_argument(
        "--only", action="append", default=[], metavar="NEIGHBOUR", help="default: all; repeat for more"
    )
    parser.add_argument("--seconds", type=float, default=14.0, help="beside each (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    from echoavatar_lab.bench.neighbours import BAR_S, bench_neighbours

    def tell(row: dict[str, Any]) -> None:
        if "skipped" in row:
            print(f"| {row['neighbour']:<28} | {row['server']:<26} | skipped: {row['skipped']} |", flush=True)
        else:
            got = f"{row['got']} of {row['sent']}"
            print(ROW.format(row["neighbour"], row["server"], got, row["worst_s"], row["median_s"]), flush=True)

    print(ROW.format("neighbour", "server", "sounds", "worst s", "median s"))
    print(ROW.format(*["---"] * 5))
    rows = bench_neighbours(
        args.model,
        servers=tuple(args.server),
        token=os.environ.get(TOKEN, ""),
        certificate=args.certificate,
        only=tuple(args.only),
        seconds=args.seconds,
        tell=tell,
    )
    print(json.dumps(rows))
    return 0 if all(row.get("worst_s", 0.0) <= BAR_S for row in rows) else 1
