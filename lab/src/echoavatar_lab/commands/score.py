"""`echoavatar score`: generated against true motion, every metric with chance level and interval; ends with JSON."""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.cli.options import DEVICE_HELP, RUNTIME_HELP, seed
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import Progress, progress_bar

if TYPE_CHECKING:
    from echoavatar_lab.evaluation.measures import Extractor
    from echoavatar_lab.evaluation.motion_folder import ReadOptions
    from echoavatar_lab.evaluation.table import Row

EXAMPLES = """examples:
  echoavatar score made true                              folders of motion with the same file names
  echoavatar score made sets/zeroeggs                     the test clips of a set (data prepare, merge or rehearse)
  echoavatar score made sets/zeroeggs --split val --common   of another split, only the clips that `made` has
  echoavatar score made true --audio sounds --picture score.png
  echoavatar score made true --extractor runs/fid         FID with your own extractor: `echoavatar train fid-encoder`
  echoavatar score made sets/zeroeggs --model default --runtime paper   first make `made` from the set's sounds
  echoavatar score --embeddings pairs.npz                 retrieval: arrays `audio` and `motion`, (pairs, size) each

Motion is .bvh of any known rig, .npz (ours, or SMPL-X parameters as EMAGE and its kin write them; the res_ before a
name is dropped, gt_ files are passed over) or .pkl (SMPL parameters as EDGE writes them; the test_ before a name is
dropped, and nothing in the file is run). What each row means: docs/metrics.md.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("made", nargs="?", type=Path, metavar="MADE", help="folder of generated motion")
    parser.add_argument("true", nargs="?", type=Path, metavar="TRUE", help="folder of true motion")
    parser.add_argument("--model", metavar="BUNDLE", help="bundle that first makes MADE for the sounds of TRUE")
    parser.add_argument("--runtime", metavar="HOW", help=f"with --model: {RUNTIME_HELP} (default: default)")
    parser.add_argument("--device", default="cpu", help=f"with --model: {DEVICE_HELP}")
    parser.add_argument("--audio", type=Path, help="folder of audio files (default: in the clips, or next to them)")
    parser.add_argument("--no-audio", action="store_true", help="leave out scores that need audio")
    parser.add_argument(
        "--kind",
        choices=("speech", "music"),
        help="what the audio is (default: its labels; music if folder or file are named so, else speech)",
    )
    parser.add_argument(
        "--split",
        choices=("test", "val", "train", "all"),
        default="test",
        help="which clips of a set are taken (default: %(default)s)",
    )
    parser.add_argument("--common", action="store_true", help="score only the clips that both folders have")
    parser.add_argument("--resample", action="store_true", help="accept motion that is not at 30 fps")
    parser.add_argument(
        "--extractor",
        default="shipped",
        help="folder of a trained extractor, or 'none' for no FID (default: %(default)s)",
    )
    parser.add_argument(
        "--embeddings",
        type=Path,
        metavar="NPZ",
        help="also score retrieval of these pairs and, with an array `style`, whether dances have their music's style",
    )
    parser.add_argument(
        "--semantic", type=Path, metavar="FOLDER", help="also SRGR, with BEAT's labels NAME.txt of this folder"
    )
    parser.add_argument(
        "--seed",
        type=seed,
        default=0,
        help="seed of resampling, shuffling and, with --model, of the motion (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print only the JSON line")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the table")


def run(args: argparse.Namespace) -> int:
    """Score, print a table, then one line of JSON."""
    from echoavatar_lab.evaluation.motion_folder import made_how
    from echoavatar_lab.evaluation.report import read_embeddings, retrieval_rows, style_rows
    from echoavatar_lab.evaluation.table import as_json, as_text, draw

    if (args.made is None) != (args.true is None) or (args.made is None and not args.embeddings):
        raise EchoAvatarError("give two folders, MADE and TRUE; `echoavatar score --help` has examples")
    if args.runtime and not args.model:
        raise EchoAvatarError("--runtime needs --model: motion that is there already is scored as it is")
    rows = _motion_rows(args) if args.made else []
    if args.embeddings:
        audio, motion, styles = read_embeddings(args.embeddings)
        rows += retrieval_rows(audio, motion, seed=args.seed)
        rows += style_rows(audio, motion, styles, seed=args.seed) if styles else []
    if args.picture:
        draw(rows, args.picture, title=f"{args.made or args.embeddings} against {args.true or 'chance'}")
    if not args.json:
        if args.made:
            how = made_how(args.made) or {"runtime": "unknown, made elsewhere"}
            print("; ".join(f"{key}: {value}" for key, value in how.items()))
        print(as_text(rows))
    print(json.dumps(as_json(rows)))
    return 0


def _motion_rows(args: argparse.Namespace) -> "list[Row]":
    from echoavatar_lab.data import DOMAINS
    from echoavatar_lab.evaluation.motion_folder import ReadOptions, read_pairs
    from echoavatar_lab.evaluation.report import score, semantic_row

    extractor = _extractor(args.extractor)
    how = ReadOptions(
        audio=args.audio,
        needs_audio=not args.no_audio,
        kind=DOMAINS.index(args.kind) if args.kind else None,
        is_common=args.common,
        is_resampling=args.resample,
        split=None if args.split == "all" else args.split,
    )
    with progress_bar() as say:
        if args.model:
            _make(args, how, partial(say, "making"))
        pairs = read_pairs(args.made, args.true, how, progress=partial(say, "reading"))
        rows = score(pairs, extractor, seed=args.seed, progress=partial(say, "scoring"))
        return rows + ([semantic_row(pairs, args.semantic, seed=args.seed)] if args.semantic else [])


def _make(args: argparse.Namespace, how: "ReadOptions", progress: Progress) -> None:
    from echoavatar.engine.pipeline import Pipeline, load_bundle
    from echoavatar_lab.evaluation.motion_folder import make_motion

    bundle = load_bundle(args.model).running(args.runtime or "default")
    note = {"runtime": bundle.runtime.label, "model": bundle.name, "seed": args.seed}
    pipeline = Pipeline(bundle, device=args.device)
    make_motion(pipeline, note, args.true, args.made, how, seed=args.seed, progress=progress)


def _extractor(name: str) -> "Extractor | None":
    from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, load_shipped

    if name == "none":
        return None
    return load_shipped() if name == "shipped" else MotionEncoder.load(Path(name))
