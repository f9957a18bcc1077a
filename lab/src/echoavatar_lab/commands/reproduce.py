"""`echoavatar reproduce`: makes a table of the paper again, with the paper's numbers beside ours."""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.cli.options import count, seed
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import progress_bar

from .config_options import add_track

if TYPE_CHECKING:
    from echoavatar_lab.tables.experiment import Experiment

EXAMPLES = """examples:
  echoavatar reproduce all --scale tiny -o runs/tables                      every table; the numbers mean nothing
  echoavatar reproduce main --scale rehearsal -o runs/tables                on the synthetic corpus, hours of a core
  echoavatar reproduce main --scale paper -o runs/tables --corpus sets/all --codec runs/codec --qwen qwen --device cuda
  echoavatar reproduce main -o runs/tables --seeds 3 --processes 2          means with deviations over three seeds
  echoavatar reproduce main -o runs/tables --corpus sets/all --with MECo=made/meco --with EDGE=made/edge
  echoavatar reproduce beat2 --scale paper -o runs/tables --corpus beat_english_v2.0.0 --extractor emage --device cuda
  echoavatar reproduce latency -o runs/tables --model bundles/main --device cuda

Corpus, tokenizers, codes, generators and motion are made once in the output folder and shared by all tables there; the
same call resumes after an interruption. The table is printed and written as .md, .csv, .tex and .png. Generators take
the paper's curriculum: stage 1, stage 2, and stage 3 for the line with exemplars.

Tables: tokenizer-ablation (variants of the tokenizer), main (corruption, baselines, exemplars, an offline reference),
beat2 (SMPL-X, EMAGE's measures; --corpus is your copy of BEAT2, --extractor a folder with EMAGE's weights as
safetensors), dataset-composition (gesture, dance, both), layouts (order of the sequence; not in the paper), latency
(stages of --model on --device), alignment (no RL, DPO, GRPO, PPO), retrieval (does sound find its motion), codec and
sound-labels (--corpus is a folder of recordings with a manifest.csv): what a reader finds in audio codes, those of
--codec beside the default bundle's; how well such recordings are labelled. user-study is no table: it writes a folder
with a study.yaml and the clips of the paper's three comparisons, and two studies after GENEA (realism.yaml, muted;
appropriateness.yaml, beside mismatched motion), for `echoavatar studio --study`. all makes every table
but codec and sound-labels, and beat2 only where no --corpus is given.
"""
TABLES = (
    "tokenizer-ablation",
    "main",
    "beat2",
    "dataset-composition",
    "layouts",
    "latency",
    "alignment",
    "retrieval",
    "codec",
    "sound-labels",
)
ALL, STUDY = "all", "user-study"
WITH = ("main", "beat2", ALL, STUDY)  # tables with lines of other systems


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("table", choices=(*TABLES, ALL, STUDY), help="which table")
    parser.add_argument(
        "--scale",
        choices=("tiny", "rehearsal", "paper"),
        default="tiny",
        help="sizes, schedules and corpus (default: %(default)s)",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of all parts and tables")
    parser.add_argument("--corpus", type=Path, help="prepared set (default: a rehearsal corpus is made)")
    parser.add_argument("--codec", type=Path, help="trained audio codec (default: the default bundle's)")
    parser.add_argument("--extractor", type=Path, help="trained FID extractor (default: the shipped one)")
    parser.add_argument("--qwen", type=Path, metavar="FOLDER", help="Qwen2.5-0.5B-Instruct, to begin generators with")
    parser.add_argument("--beats", type=Path, metavar="FILE", help="BEATs_iter3_plus_AS2M.pt, for the alignment reward")
    parser.add_argument(
        "--sounds", type=Path, metavar="FOLDER", help="sounds to tune on (`data rl-corpus`; default: some are made)"
    )
    parser.add_argument(
        "--with",
        dest="others",
        action="append",
        default=[],
        type=_system,
        metavar="NAME=FOLDER",
        help="a line for another system: its motion for the test clips, as .npz (ours, or SMPL-X as EMAGE writes it),"
        " .bvh or .pkl (SMPL as EDGE writes it), named after the clips; may be repeated",
    )
    parser.add_argument("--resample", action="store_true", help="take motion of --with that is not at 30 fps")
    parser.add_argument(
        "--simulate", action="store_true", help="user-study: made-up raters judge the studies, which tests their design"
    )
    parser.add_argument("--model", help="bundle for latency (default: the default bundle)")
    parser.add_argument("--device", default="cpu", help="where to train and generate (default: %(default)s)")
    parser.add_argument("--seeds", type=count, default=1, metavar="N", help="train and sample N times (default: 1)")
    parser.add_argument(
        "--processes",
        type=count,
        default=1,
        metavar="N",
        help="parts made at a time; with --device cuda on all GPUs by turns (default: %(default)s)",
    )
    add_track(parser)
    parser.add_argument(
        "--runtime",
        default="paper",
        metavar="HOW",
        help="how generators run: paper, default (all of ours), or what to keep of ours (default: %(default)s)",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes that make a corpus (default: %(default)s)")
    parser.add_argument("--seed", type=seed, default=0, help="seed of everything random (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Make what is missing, then print and write the table."""
    from tqdm import tqdm

    from echoavatar.engine.pipeline.runtime import Runtime
    from echoavatar.nn.device import find_device
    from echoavatar_lab.held_folder import hold_folder
    from echoavatar_lab.tables.experiment import Experiment, Sources
    from echoavatar_lab.tables.scale import SCALES
    from echoavatar_lab.training.metrics_log import want_trackers

    want_trackers(args.track)  # these refuse before any work
    find_device(args.device)
    runtime = Runtime().chosen(args.runtime).label
    others = _others(args)
    with hold_folder(args.output / args.scale), progress_bar() as say:
        experiment = Experiment(
            args.output / args.scale,
            SCALES[args.scale],
            Sources(
                *(args.corpus, args.codec, args.extractor, args.qwen, others, args.resample, args.model),
                beats=args.beats,
                sounds=args.sounds,
            ),
            device=args.device,
            seed=args.seed,
            runtime=runtime,
            workers=args.workers,
            trackers=args.track,
            say=lambda line: tqdm.write(line, file=sys.stderr),
            progress=partial(say, args.table),
        )
        if args.table == STUDY:
            from echoavatar_lab.tables.user_study import write_study

            path = write_study(experiment)
            print(f"written: {path}; open it with `echoavatar studio --study`", flush=True)
            return _simulate(path.parent) if args.simulate else 0
        return _tables(args, experiment)


def _simulate(folder: Path) -> int:
    """Have the studio's made-up raters judge the studies of a folder, one after another."""
    from echoavatar.cli import main

    words = [word for path in sorted(folder.glob("*.yaml")) for word in ("--study", str(path))]
    place = folder / "simulated"
    return main(["studio", "simulate", *words, "--folder", str(place / "studio"), "-o", str(place)])


def _tables(args: argparse.Namespace, experiment: "Experiment") -> int:
    """Make one table, or all; with all, a table that fails is told and does not stop the others."""
    from echoavatar_lab.tables.run import reproduce
    from echoavatar_lab.tables.table import markdown, write

    is_all = args.table == ALL
    failed = []
    for name in _all_tables(args) if is_all else [args.table]:
        experiment.say(f"table: {name}")
        command = _command(args, name)
        try:
            table = reproduce(name, experiment, command=command, seeds=args.seeds, processes=args.processes)
        except EchoAvatarError as error:
            if not is_all:
                raise
            failed.append(f"{name}: {error}")
            continue
        paths = write(table, args.output / args.scale)
        print(markdown(table))
        print("written: " + ", ".join(str(path) for path in paths), flush=True)
    if failed:
        raise EchoAvatarError(f"{len(failed)} tables could not be made; {'; '.join(failed)}")
    return 0


def _all_tables(args: argparse.Namespace) -> list[str]:
    """Every table that needs motion; BEAT2's needs a corpus of its own."""
    left_out = {"codec", "sound-labels"} | ({"beat2"} if args.corpus else set())
    if args.corpus:
        print("beat2 is left out: its --corpus is a copy of BEAT2; `reproduce beat2` makes it", file=sys.stderr)
    return [name for name in TABLES if name not in left_out]


def _others(args: argparse.Namespace) -> dict[str, Path]:
    """Folders of other systems by name."""
    if args.others and args.table not in WITH:
        raise EchoAvatarError(f"{args.table} has no lines of other systems; --with goes with {', '.join(WITH)}")
    others = dict(args.others)
    if len(others) < len(args.others):
        raise EchoAvatarError("two --with have the same name; name every system once")
    return others


def _system(text: str) -> tuple[str, Path]:
    name, sign, folder = text.partition("=")
    if not (name and sign and folder):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FOLDER, such as MECo=made/meco")
    return name, Path(folder)


def _command(args: argparse.Namespace, table: str) -> str:
    """The command for the notes of the table, with folder names instead of paths."""
    words = [f"echoavatar reproduce {table} --scale {args.scale} -o {args.output.name}"]
    for name in ("corpus", "codec", "extractor", "qwen", "beats", "sounds"):
        given = getattr(args, name)
        words += [f"--{name} {given.name}"] if given else []
    words += [f"--with {name}={folder.name}" for name, folder in args.others] if table in WITH else []
    words += ["--resample"] if args.resample and table in WITH else []
    words += [f"--model {Path(args.model).name}"] if args.model and table == "latency" else []
    words += [f"--device {args.device}"] if args.device != "cpu" else []
    words += [f"--runtime {args.runtime}"] if args.runtime != "paper" else []
    words += [f"--seed {args.seed}"] if args.seed else []
    words += [f"--seeds {args.seeds}"] if args.seeds > 1 else []
    return " ".join(words)
