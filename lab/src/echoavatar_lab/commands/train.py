"""`echoavatar train`: codec, tokenizer, generator, face in this order; fingers, FID extractor. Each resumes."""

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError

from . import train_codec, train_decoder, train_face, train_fid_encoder, train_fingers, train_generator, train_tokenizer
from .recipe import Options, Settings

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

Calling a command again resumes its run, also after SIGTERM. Sizes are those of the default bundle; recipes/ has the
paper's, the default bundle's and tiny ones for every stage (--recipe). `echoavatar plot RUN -o curves.png` draws a run.
Several GPUs: accelerate launch -m echoavatar train generator ... --device cuda (docs/training.md).
"""


SEED = "seed of windows and noise; a run with --start sees the same windows again unless it has another"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    parser.epilog = ORDER
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)

    def stage(name: str, summary: str, source: str) -> tuple[argparse.ArgumentParser, Options]:
        child = kinds.add_parser(name, help=summary)
        _add_folders(child, source)
        options = Options(child)
        child.add_argument("--device", default="cpu", help="cpu or cuda (default: %(default)s)")
        child.add_argument(
            "--track",
            action="append",
            default=[],
            choices=("tensorboard", "wandb"),
            help="log metrics there as well as in metrics.jsonl; may be given twice",
        )
        return child, options

    corpus = "corpus folder (`data rehearse`, `data prepare`)"
    train_codec.add_arguments(*stage("codec", "the audio codec, on the corpus's audio", corpus))
    train_tokenizer.add_arguments(*stage("tokenizer", "the motion tokenizer, on the corpus's motion", corpus))
    decoder, options = stage(
        "decoder", "a trained tokenizer's decoder, on the steady codes that a generator learns", corpus
    )
    train_decoder.add_arguments(decoder, options)
    tokens = kinds.add_parser("tokens", help="encode the corpus with a trained codec and tokenizer")
    _add_folders(tokens, corpus)
    options = Options(tokens)
    options.add(
        "--patience",
        "training.patience",
        0.4,
        type=float,
        help="cost of changing a code, which keeps codes steady, so that the generator need not predict changes without"
        " meaning; 0 takes the nearest code, as in the paper",
    )
    options.add(
        "--no-level",
        "training.is_leveled",
        True,
        action="store_true",
        help="encode sound at its own loudness, as in the paper; a bundle with the generator then runs so, too",
    )
    generator, options = stage("generator", "the generator, on a folder of codes", "folder of codes (`train tokens`)")
    train_generator.add_arguments(generator, options, SEED)
    face, options = stage(
        "face", "the face model, on pairs of audio and ARKit curves", "folder of face clips (`data face`)"
    )
    train_face.add_arguments(face, options, SEED)
    takes = "corpus folder (`data rehearse`), or folder of BVH clips"
    train_fingers.add_arguments(
        *stage("fingers", "the model behind `refine-fingers`, on motion with good fingers", takes)
    )
    train_fid_encoder.add_arguments(
        *stage("fid-encoder", "the extractor behind `score`'s FID, on the corpus's motion", corpus)
    )
    for child in (tokens, generator):
        child.add_argument("--codec", type=Path, required=True, help="trained codec")
        child.add_argument("--tokenizer", type=Path, required=True, help="trained tokenizer")


def _add_folders(parser: argparse.ArgumentParser, source: str) -> None:
    parser.add_argument("source", type=Path, metavar="SOURCE", help=source)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")


def run(args: argparse.Namespace) -> int:
    """Train one model."""
    if not args.source.is_dir():
        raise EchoAvatarError(
            f"{args.source} is not a folder; make a corpus with `echoavatar data rehearse` or `data prepare`"
        )
    with tqdm(unit="step", smoothing=0.05, disable=os.environ.get("RANK", "0") != "0") as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        if args.kind == "tokens":
            _tokens(args, progress)
        else:
            _train(args, progress)
    print(f"{args.kind} in {args.output}")
    return 0


Progress = Callable[[int, int], None]


def _train(args: argparse.Namespace, progress: Progress) -> None:
    base = train_codec.BASE if args.kind == "codec" else None
    settings: Settings = args.options.settings(args, base)
    how: dict[str, Any] = {"device": args.device, "trackers": args.track, "progress": progress}
    if args.kind == "generator":
        train_generator.train(args, settings, how)
        return
    if args.kind in ("fingers", "fid-encoder") and how.pop("device") != "cpu":
        raise EchoAvatarError(f"{args.kind} trains on a CPU only, in minutes; leave out --device")
    trainings = {
        "codec": train_codec.train,
        "tokenizer": train_tokenizer.train,
        "decoder": train_decoder.train,
        "face": train_face.train,
        "fingers": train_fingers.train,
        "fid-encoder": train_fid_encoder.train,
    }
    trainings[args.kind](args, settings, _card(args), how)


def _card(args: argparse.Namespace) -> dict[str, object]:
    """The card's data, command and licence."""
    given = [f"-o {args.output}"]
    left_out = ("command", "kind", "source", "options", "output", "device", "track")
    for key, value in vars(args).items():
        if key not in left_out and value not in (None, False):
            flag = "--" + key.replace("_", "-")
            given.append(flag if value is True else f"{flag} {value}")
    return {
        "data": str(args.source),
        "command": f"echoavatar train {args.kind} {args.source} {' '.join(given)}",
        "licence": _licence(args.source),
    }


def _licence(source: Path) -> str:
    """Licence of weights trained on a folder; a prepared data set names the terms that bind them."""
    from echoavatar_lab.data import Corpus

    bound = Corpus(source).manifest.info.get("licence") if (source / "manifest.json").exists() else None
    return f"as its data: {bound}" if bound else "Apache-2.0"


def _tokens(args: argparse.Namespace, progress: Progress) -> None:
    from echoavatar.models.audio import AudioCodec
    from echoavatar.models.tokenizer import BodyTokenizer
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.models.tokenize import TokenSettings, tokenize_corpus

    codec = AudioCodec.load(args.codec).eval()
    tokenizer = BodyTokenizer.load(args.tokenizer).eval()
    corpus = Corpus(args.source)
    settings = args.options.settings(args).checked(TokenSettings, "training")
    tokenize_corpus(
        corpus,
        codec,
        tokenizer,
        args.output,
        is_mirrored_too=corpus.can_mirror,
        patience=settings.patience,
        is_leveled=settings.is_leveled,
        progress=progress,
    )
