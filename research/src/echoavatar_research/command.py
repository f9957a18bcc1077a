"""`echoavatar reproduce`: makes a table of the paper again, with the paper's numbers beside ours."""

import argparse
import sys
from pathlib import Path

EXAMPLES = """examples:
  echoavatar reproduce tokenizer-ablation --scale tiny -o runs/tiny         every part runs; the numbers mean nothing
  echoavatar reproduce main --scale rehearsal -o runs/rehearsal             on the synthetic corpus, hours on a CPU
  echoavatar reproduce main --scale paper -o runs/paper --corpus sets/all --codec runs/codec --qwen qwen --device cuda
  echoavatar reproduce beat2 --scale paper -o runs/paper --corpus beat_english_v2.0.0 --extractor emage --device cuda

Corpus, tokenizers, codes, generators and motion are made once in the output folder and shared by all tables there; the
same call resumes after an interruption. The table is printed and written as .md, .csv, .tex and .png.

Tables: tokenizer-ablation (variants of the tokenizer), main (corruption, baselines, an offline reference), beat2
(SMPL-X, EMAGE's measures; --corpus is your copy of BEAT2, --extractor a folder with EMAGE's weights as safetensors),
dataset-composition (gesture, dance, both), layouts (order of the sequence; not in the paper), latency (stages, on
this machine), alignment (no RL, DPO, GRPO, PPO), codec and sound-labels (--corpus is a folder of recordings
with a manifest.csv): what a reader finds in audio codes, those of --codec beside the default bundle's; how well such
recordings are labelled.
"""
TABLES = (
    "tokenizer-ablation",
    "main",
    "beat2",
    "dataset-composition",
    "layouts",
    "latency",
    "alignment",
    "codec",
    "sound-labels",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument("table", choices=TABLES, help="which table")
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
    parser.add_argument("--device", default="cpu", help="where to train (default: %(default)s)")
    parser.add_argument(
        "--runtime",
        default="paper",
        metavar="HOW",
        help="how generators run: paper, default (all of ours), or what to keep of ours (default: %(default)s)",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes that make a corpus (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Make what is missing, then print and write the table."""
    from tqdm import tqdm

    from echoavatar.engine.pipeline.runtime import Runtime
    from echoavatar_research.scale import SCALES

    from .experiment import Experiment, Sources
    from .formats import markdown, write
    from .run import reproduce

    with tqdm(disable=not sys.stderr.isatty(), leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total, bar.n = total, done
            bar.refresh()

        experiment = Experiment(
            args.output / args.scale,
            SCALES[args.scale],
            Sources(args.corpus, args.codec, args.extractor, args.qwen),
            device=args.device,
            seed=args.seed,
            runtime=Runtime().chosen(args.runtime).label,  # refuses an unknown name before any work
            workers=args.workers,
            say=lambda line: tqdm.write(line, file=sys.stderr),
            progress=progress,
        )
        table = reproduce(args.table, experiment, command=_command(args))
    paths = write(table, args.output / args.scale)
    print(markdown(table))
    print("written: " + ", ".join(str(path) for path in paths))
    return 0


def _command(args: argparse.Namespace) -> str:
    """The command for the notes of the table, with folder names instead of paths."""
    words = [f"echoavatar reproduce {args.table} --scale {args.scale} -o {args.output.name}"]
    for name in ("corpus", "codec", "extractor", "qwen"):
        given = getattr(args, name)
        words += [f"--{name} {given.name}"] if given else []
    words += [f"--device {args.device}"] if args.device != "cpu" else []
    words += [f"--runtime {args.runtime}"] if args.runtime != "paper" else []
    words += [f"--seed {args.seed}"] if args.seed else []
    return " ".join(words)
