"""`echoavatar plot`: draws the metrics of training runs as curves, one run or several side by side."""

import argparse
from pathlib import Path

EXAMPLES = """examples:
  echoavatar plot runs/generator -o curves.png
  echoavatar plot runs/generator runs/generator2 -o both.png --metrics loss nll_speech nll_music
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="output folder of `train`")
    parser.add_argument("-o", "--output", type=Path, required=True, help="picture: .png, .svg or .pdf")
    parser.add_argument("--metrics", nargs="+", default=[], metavar="NAME", help="only these (default: all)")


def run(args: argparse.Namespace) -> int:
    """Draw the curves and print the last values."""
    from echoavatar_lab.training.curves import draw, read_curves

    runs = {name: read_curves(path) for name, path in zip(_names(args.runs), args.runs, strict=True)}
    draw(runs, args.output, metrics=args.metrics)
    for name, curves in runs.items():
        last = {key: curve.values[-1] for key, curve in curves.items() if key in ("loss", "gradient")}
        told = ", ".join(f"{key} {value:.4g}" for key, value in last.items())
        print(f"{name}: step {max(curve.steps[-1] for curve in curves.values()):.0f}{', ' + told if told else ''}")
    print(f"curves in {args.output}")
    return 0


def _names(paths: list[Path]) -> list[str]:
    """The shortest names that distinguish the runs: the folder's, with as many parents as necessary."""
    for depth in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{path} ({at + 1})" for at, path in enumerate(paths)]
