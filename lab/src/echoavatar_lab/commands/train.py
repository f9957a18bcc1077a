"""`echoavatar train`: codec, tokenizer, generator, face in this order; fingers, FID extractor. Each resumes."""

import argparse
import os
from pathlib import Path
from typing import Any

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import Progress

from . import train_body, train_others
from .config_options import add_minutes, add_track, command_line
from .recipe import Given, Options

ORDER = """all commands from nothing to a bundle:
  echoavatar data rehearse --hours 3.5 --seed 1 -o corpus
  echoavatar train codec corpus -o runs/codec --minutes 40
  echoavatar train tokenizer corpus -o runs/tokenizer --steps 6000
  echoavatar train decoder corpus -o runs/decoder --tokenizer runs/tokenizer  (optional: steadier motion)
  echoavatar train tokens corpus -o runs/tokens --codec runs/codec --tokenizer runs/tokenizer
  echoavatar train generator runs/tokens -o runs/generator --codec runs/codec --tokenizer runs/tokenizer
  echoavatar data face --rehearse 1.1 -o faces
  echoavatar train face faces -o runs/face
  echoavatar bundle runs -o my-bundle

Calling a command again resumes its run, also after SIGTERM. Sizes are those of the default bundle; lab/recipes has the
paper's, the default bundle's and tiny ones for every stage (--recipe). `echoavatar plot RUN -o curves.png` draws a run.
Several GPUs: accelerate launch -m echoavatar train generator ... --device cuda (docs/training.md).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    parser.epilog = ORDER
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name, stage in (train_body.stages() | train_others.stages()).items():
        child = kinds.add_parser(name, help=stage.summary)
        if stage.examples:
            child.formatter_class, child.epilog = argparse.RawDescriptionHelpFormatter, stage.examples
        child.add_argument("source", type=Path, metavar="SOURCE", help=stage.source)
        child.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")
        options = Options(child, model=stage.model, training=stage.training, base=stage.base)
        child.set_defaults(stage=stage)
        for option in stage.options:
            options.add(*option.split())
        if stage.add:
            stage.add(child)
        if name != "tokens":
            child.add_argument("--device", default="cpu", help="cpu or cuda (default: %(default)s)")
            add_track(child)
            if name != "codec":  # whose schedule is fitted to its minutes
                add_minutes(child)


def run(args: argparse.Namespace) -> int:
    """Train one model."""
    if not args.source.is_dir():
        raise EchoAvatarError(
            f"{args.source} is not a folder; make a corpus with `echoavatar data rehearse` or `data prepare`"
        )
    with tqdm(unit="step", smoothing=0.05, disable=os.environ.get("RANK", "0") != "0" or None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        args.stage.train(Given(args, args.options.settings(args), _card(args), _how(args, progress)))
    print(f"{args.kind} in {args.output}")
    return 0


def _how(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Device, trackers, minutes and progress, as far as the stage takes them."""
    if args.kind == "tokens":
        return {"progress": progress}
    how: dict[str, Any] = {"device": args.device, "trackers": args.track, "progress": progress}
    if args.kind != "codec":
        how["minutes"] = args.minutes
    if args.kind in ("fingers", "fid-encoder") and how.pop("device") != "cpu":
        raise EchoAvatarError(f"{args.kind} trains on a CPU only, in minutes; leave out --device")
    return how


def _card(args: argparse.Namespace) -> dict[str, object]:
    """The card's data, command and licence."""
    return {"data": str(args.source), "command": command_line(args), "licence": _licence(args.source)}


def _licence(source: Path) -> str:
    """Licence of weights trained on a folder; a prepared data set names the terms that bind them."""
    from echoavatar_lab.data import Corpus

    bound = Corpus(source).manifest.info.get("licence") if (source / "manifest.json").exists() else None
    return f"as its data: {bound}" if bound else "Apache-2.0"
