"""`echoavatar train`: codec, tokenizer, generator, face, in this order, fingers, and FID's extractor; each resumes."""

import argparse
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from ..errors import EchoAvatarError
from . import train_fid_encoder, train_fingers

ORDER = """the whole way from nothing to a bundle:
  echoavatar data rehearse --hours 3.5 --seed 1 -o corpus
  echoavatar train codec corpus -o runs/codec --minutes 40
  echoavatar train tokenizer corpus -o runs/tokenizer --steps 6000
  echoavatar train tokens corpus -o runs/tokens --codec runs/codec --tokenizer runs/tokenizer
  echoavatar train generator runs/tokens -o runs/generator --codec runs/codec --tokenizer runs/tokenizer
  echoavatar data face --rehearse 1.1 -o faces
  echoavatar train face faces -o runs/face
  echoavatar bundle runs -o my-bundle

Training resumes from its output folder. Sizes are those of the default bundle.
"""


SEED = (
    "of windows and noise; a run with --start sees the same windows again unless it has another (default: 0)"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    parser.epilog = ORDER
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    codec = kinds.add_parser("codec", help="the audio codec, on the corpus's sound and other recordings")
    codec.add_argument("--recordings", type=Path, help="folder of real sound to learn from as well")
    codec.add_argument("--minutes", type=float, default=40.0, help="training time (default: %(default)s)")
    tokenizer = kinds.add_parser("tokenizer", help="the motion tokenizer, on the corpus's motion")
    tokenizer.add_argument("--steps", type=int, default=6000, help="optimiser steps (default: %(default)s)")
    tokenizer.add_argument("--start", type=Path, help="trained tokenizer of the same sizes to begin with")
    tokens = kinds.add_parser("tokens", help="turn the corpus into codes with a trained codec and tokenizer")
    tokens.add_argument(
        "--patience",
        type=float,
        default=0.4,
        help="price of a change of code, so that codes stay where they may and the generator need not foretell "
        "flips that mean nothing; 0 takes the nearest (default: %(default)s)",
    )
    generator = kinds.add_parser("generator", help="the generator, on a folder of codes")
    generator.add_argument("--steps", type=int, default=3200, help="optimiser steps (default: %(default)s)")
    generator.add_argument("--batch", type=int, default=4, help="windows per step (default: %(default)s)")
    generator.add_argument(
        "--rate", type=float, default=1e-3, help="peak learning rate (default: %(default)s)"
    )
    generator.add_argument(
        "--optimiser", choices=("adamw", "muon"), default="muon", help="(default: %(default)s; paper: adamw)"
    )
    generator.add_argument("--width", type=int, default=192, help="channels (default: %(default)s)")
    generator.add_argument("--layers", type=int, default=6, help="transformer layers (default: %(default)s)")
    generator.add_argument(
        "--window",
        type=int,
        default=10,
        help="chunks a position sees; the paper's 4 s are 15 (default: %(default)s)",
    )
    generator.add_argument(
        "--corruption",
        choices=("hierarchical", "uniform", "none"),
        default="hierarchical",
        help="of the motion codes in the context (default: %(default)s)",
    )
    generator.add_argument(
        "--blind",
        type=float,
        default=0.2,
        help="share of windows whose context motion is all noise, so that the sound must tell (default: %(default)s)",
    )
    generator.add_argument(
        "--out-of-step",
        type=float,
        default=0.15,
        help="share of windows whose context runs early or late: the sound tells the phase (default: %(default)s)",
    )
    generator.add_argument(
        "--cue-weight",
        type=float,
        default=0.3,
        help="weight of telling beats and stresses from the sound, where the corpus knows them (default: %(default)s)",
    )
    generator.add_argument(
        "--exemplar",
        type=float,
        default=0.0,
        help="share of windows told a set of their own codes, so that actions can steer (default: %(default)s)",
    )
    generator.add_argument("--start", type=Path, help="trained generator of the same sizes to begin with")
    generator.add_argument("--seed", type=int, default=0, help=SEED)
    generator.add_argument(
        "--minutes", type=float, help="stop this call after so many minutes; call again to go on"
    )
    face = kinds.add_parser("face", help="the face model, on pairs of sound and ARKit curves")
    face.add_argument("--steps", type=int, default=8000, help="optimiser steps (default: %(default)s)")
    face.add_argument("--batch", type=int, default=32, help="windows per step (default: %(default)s)")
    face.add_argument(
        "--rate", type=float, default=1e-3, help="peak learning rate (default: %(default)s; paper: 2e-4)"
    )
    face.add_argument(
        "--listen",
        type=int,
        default=0,
        help="so many of the steps at first teach the encoder alone (default: %(default)s)",
    )
    face.add_argument(
        "--no-tempo",
        action="store_true",
        help="not also slower and faster; rehearsed clips differ in pace anyway, and much memory is saved",
    )
    face.add_argument("--start", type=Path, help="trained face model of the same sizes to begin with")
    face.add_argument("--seed", type=int, default=0, help=SEED)
    face.add_argument("--paper", action="store_true", help="sizes of the paper (width 256), mel encoder")
    face.add_argument(
        "--minutes", type=float, help="stop this call after so many minutes; call again to go on"
    )
    fingers = kinds.add_parser(
        "fingers", help="the model behind `refine-fingers`, on motion with good fingers"
    )
    train_fingers.add_arguments(fingers)
    fid_encoder = kinds.add_parser(
        "fid-encoder", help="the extractor behind `score`'s FID, on the corpus's motion"
    )
    train_fid_encoder.add_arguments(fid_encoder)
    sources = {
        generator: "folder of codes (`train tokens`)",
        face: "folder of face clips (`data face`)",
        fingers: "corpus folder (`data rehearse`), or folder of BVH clips",
    }
    for child in (codec, tokenizer, tokens, generator, face, fingers, fid_encoder):
        source = sources.get(child, "corpus folder (`data rehearse`, `data prepare`)")
        child.add_argument("source", type=Path, metavar="SOURCE", help=source)
        child.add_argument(
            "-o", "--output", type=Path, required=True, help="folder to train in, or to go on in"
        )
    for child in (tokens, generator):
        child.add_argument("--codec", type=Path, required=True, help="trained codec")
        child.add_argument("--tokenizer", type=Path, required=True, help="trained tokenizer")


def run(args: argparse.Namespace) -> int:
    """Train one part."""
    if not args.source.is_dir():
        raise EchoAvatarError(
            f"{args.source} is not a folder; make a corpus with `echoavatar data rehearse` or `data prepare`"
        )
    with tqdm(unit="step", smoothing=0.05) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        trainings = {
            "codec": _codec,
            "tokenizer": _tokenizer,
            "tokens": _tokens,
            "generator": _generator,
            "face": _face,
            "fingers": _fingers,
            "fid-encoder": _fid_encoder,
        }
        trainings[args.kind](args, progress)
    print(f"{args.kind} in {args.output}")
    return 0


Progress = Callable[[int, int], None]


def _card(args: argparse.Namespace) -> dict[str, object]:
    """What every card must say: data, command, licence."""
    given = " ".join(
        f"--{key} {value}" for key, value in vars(args).items() if key not in ("command", "kind", "source")
    )
    return {
        "data": str(args.source),
        "command": f"echoavatar train {args.kind} {args.source} {given}",
        "licence": _licence(args.source),
    }


def _licence(source: Path) -> str:
    """Of weights trained on a folder: a prepared set says whose terms bind them."""
    from ..data import Corpus

    bound = Corpus(source).manifest.info.get("licence") if (source / "manifest.json").exists() else None
    return f"as its data: {bound}" if bound else "Apache-2.0"


def _codec(args: argparse.Namespace, progress: Progress) -> None:
    from ..audio.pool import AudioGroup, AudioPool, read_group
    from ..audio.train import CodecTrainingConfig, train_codec
    from ..data import Corpus

    corpus = Corpus(args.source)
    heard = [entry.name for entry in corpus.entries(has_mirrored=False) if entry.has_sound]
    groups = [AudioGroup(args.source.name, tuple(corpus.sound(name) for name in heard))]
    if args.recordings:
        groups.append(read_group(args.recordings, weight=0.5))
    config = CodecTrainingConfig(minutes=args.minutes, steps=100_000, unquantized=300, learning_rate=1.5e-3)
    train_codec(config, args.output, AudioPool(groups), card=_card(args), progress=progress)


def _tokenizer(args: argparse.Namespace, progress: Progress) -> None:
    from ..data import Corpus
    from ..tokenizer import BodyTokenizer
    from ..tokenizer.train import bundle_recipe, continued, train_tokenizer

    corpus = Corpus(args.source)
    clips = [
        corpus.motion(name) for name in corpus.names("train", has_mirrored=False)
    ]  # windows are mirrored
    tests = [corpus.motion(name) for name in corpus.names("test", has_mirrored=False)]
    config, training = bundle_recipe(corpus.skeleton, args.steps)
    training = training.model_copy(update={"is_mirrored": corpus.can_mirror})
    start = BodyTokenizer.load(args.start) if args.start else None
    training = continued(training) if start else training
    train_tokenizer(
        config, training, clips, tests, args.output, card=_card(args), start=start, progress=progress
    )


def _tokens(args: argparse.Namespace, progress: Progress) -> None:
    from ..audio import AudioCodec
    from ..data import Corpus
    from ..pipeline.tokenize import tokenize_corpus
    from ..tokenizer import BodyTokenizer

    codec = AudioCodec.load(args.codec).eval()
    tokenizer = BodyTokenizer.load(args.tokenizer).eval()
    corpus = Corpus(args.source)
    tokenize_corpus(
        corpus,
        codec,
        tokenizer,
        args.output,
        is_mirrored_too=corpus.can_mirror,
        patience=args.patience,
        progress=progress,
    )


def _generator(args: argparse.Namespace, progress: Progress) -> None:
    from ..audio import AudioCodec
    from ..generator import Generator, GeneratorConfig, TokenClip, patience_of
    from ..generator.train import GeneratorTraining, train_generator
    from ..tokenizer import BodyTokenizer
    from ..tokens import TokenLayout

    codec, tokenizer = AudioCodec.load(args.codec), BodyTokenizer.load(args.tokenizer)
    clips = [TokenClip.load(path) for path in sorted(args.source.glob("*.npz"))]
    layout = TokenLayout.compact(
        audio_codes=codec.config.codes,
        motion_layers=tokenizer.config.layers,
        motion_codes=tokenizer.config.codes,
    )
    config = GeneratorConfig(
        layout=layout,
        width=args.width,
        layers=args.layers,
        mlp=3 * args.width,
        window_chunks=args.window,
        exemplar=args.exemplar > 0,
        patience=patience_of(clips),
    )
    weights = tuple(0.7**layer for layer in range(layout.motion_layers))
    training = GeneratorTraining(
        steps=args.steps,
        batch=args.batch,
        chunks=args.window + 6,  # longer than the window, so that the steady stream is trained too
        learning_rate=args.rate,
        optimiser=args.optimiser,
        corruption=args.corruption,
        blind=args.blind,
        out_of_step=args.out_of_step,
        exemplar=args.exemplar,
        cue_weight=args.cue_weight,
        depth_weights=weights,
        seed=args.seed,
    )
    train_generator(
        config,
        training,
        clips,
        args.output,
        minutes=args.minutes,
        start=Generator.load(args.start) if args.start else None,
        audio_codebooks=codec.codebooks,
        motion_codebooks=tokenizer.codebooks(),
        progress=progress,
    )


def _face(args: argparse.Namespace, progress: Progress) -> None:
    from ..face import FaceConfig, FaceModel, MelConfig, paper_face
    from ..face.clip import load_clips
    from ..face.config import FaceTraining
    from ..face.train import train_face

    config = paper_face(encoder=MelConfig()) if args.paper else FaceConfig()
    training = FaceTraining(
        steps=args.steps,
        listen=args.listen,
        batch=args.batch,
        learning_rate=args.rate,
        tempo=not args.no_tempo,
        seed=args.seed,
    )
    train_face(
        config,
        training,
        load_clips(args.source),
        args.output,
        minutes=args.minutes,
        start=FaceModel.load(args.start) if args.start else None,
        card=_card(args),
        progress=progress,
    )


def _fingers(args: argparse.Namespace, progress: Progress) -> None:
    train_fingers.train(args, _card(args), progress)


def _fid_encoder(args: argparse.Namespace, progress: Progress) -> None:
    train_fid_encoder.train(args, _card(args), progress)
