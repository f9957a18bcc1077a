"""`echoavatar align compare`: compares generators on held-out prompts; writes JSON and a table, prints the JSON."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from echoavatar_lab.align.start import AlignmentSetup


def add_arguments(child: argparse.ArgumentParser) -> None:
    """Declare the arguments that the other `align` commands do not have."""
    child.add_argument(
        "--beside",
        type=Path,
        nargs="+",
        action="append",
        default=[],
        metavar="FOLDER",
        help="tuned generator, or runs of one method with several seeds, which share a line; may be repeated",
    )
    child.add_argument("--prompts", type=int, default=48, help="held-out prompts (default: %(default)s)")
    child.add_argument("--group", type=int, default=4, help="continuations of each (default: %(default)s)")
    child.add_argument("--past", type=int, default=3, help="chunks of past (default: %(default)s)")
    child.add_argument("--length", type=int, default=9, help="chunks in a continuation (default: %(default)s)")
    child.add_argument("--seed", type=int, default=0, help="seed of sampling (default: %(default)s)")
    child.add_argument("-o", "--output", type=Path, required=True, metavar="JSON", help="file to write")


def run(args: argparse.Namespace, ready: "AlignmentSetup") -> int:
    """Measure and print."""
    from echoavatar.errors import MotionError
    from echoavatar.models.generator import Generator
    from echoavatar_lab.align.compare import compare
    from echoavatar_lab.align.prompts import PromptSampler
    from echoavatar_lab.align.seeds import as_markdown, over_seeds
    from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped

    if not ready.test:
        raise MotionError(f"{args.source} holds no clip of split test, so there is nothing to measure on")
    prompts = PromptSampler(ready.test, past=args.past, length=args.length).spread(args.prompts)
    generators = {"untuned": ready.generator} | {
        str(folder): Generator.load(folder) for folders in args.beside for folder in folders
    }
    found = compare(
        generators,
        ready.tokenizer,
        prompts,
        ready.mix,
        load_shipped(),
        group=args.group,
        seed=args.seed,
        device=args.device,
    )
    lines = {
        ", ".join(map(str, folders)): over_seeds(found["untuned"], [found[str(folder)] for folder in folders])
        for folders in args.beside
    }
    told = {"prompts": len(prompts), "group": args.group, "seed": args.seed, "found": found, "over_seeds": lines}
    args.output.write_text(json.dumps(told) + "\n", encoding="utf-8")
    args.output.with_suffix(".md").write_text(as_markdown(found, lines), encoding="utf-8")
    print(json.dumps(told))
    return 0
