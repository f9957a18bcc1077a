"""`echoavatar align soup`: mixes generators that were tuned from the same one."""

import argparse
from pathlib import Path


def add_arguments(child: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    child.add_argument("runs", nargs="+", metavar="FOLDER=SHARE", help="tuned generator and its share, such as 0.5")
    child.add_argument("-o", "--output", type=Path, required=True, help="folder for the mix")
    child.add_argument("--model", default="default", help="bundle that the runs began with (default: %(default)s)")
    child.add_argument("--generator", type=Path, help="generator that they began with, instead of the bundle's")


def run(args: argparse.Namespace) -> int:
    """Mix and save."""
    from echoavatar.checkpoint import read_card
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar.models.generator import Generator
    from echoavatar_lab.align.rewards import parse_weights
    from echoavatar_lab.align.soup import soup

    shares = parse_weights(args.runs, "run", "runs/a=0.5")
    start = Generator.load(args.generator) if args.generator else load_bundle(args.model).generator
    mixed = soup(start, {name: (Generator.load(Path(name)), share) for name, share in shares.items()})
    cards = {name: read_card(Path(name)) for name in shares}
    about = {"kind": "generator", "begun_from": str(args.generator or args.model), "shares": shares}
    licences = {str(card.get("licence", "unknown")) for card in cards.values()}
    mixed.save(args.output, about | {"licence": " and ".join(sorted(licences)), "runs": cards})
    print(f"{len(shares)} runs mixed in {args.output}")
    return 0
