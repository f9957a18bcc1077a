"""`echoavatar train codec`: trains the audio codec on a corpus's audio and other recordings."""

import argparse
from pathlib import Path
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only the codec has."""
    parser.add_argument(
        "--recordings",
        type=Path,
        help="folder of recorded speech and music to train on as well, each as often as the corpus; what its"
        " manifest.csv marks as test is left out",
    )
    parser.add_argument("--start", type=Path, help="trained codec of the same sizes (a run, or part of a bundle)")
    parser.add_argument(
        "--from",
        dest="origin",
        metavar="NAME",
        help="take a published EnCodec instead of training: a folder of it, or facebook/encodec_24khz (the paper's)"
        " from the local model cache",
    )
    options.add("--minutes", "training.minutes", 40.0, type=float, help="training time, the schedule fitted to it")


BASE = {"training": {"steps": 100_000, "unquantized": 300, "learning_rate": 1.5e-3}}


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the audio of the corpus's train split and of the recordings."""
    from echoavatar.models.audio import AudioCodec, CodecConfig
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.models.audio.recordings import AudioGroup, AudioPool, read_groups
    from echoavatar_lab.models.audio.train import CodecTrainingConfig, train_codec

    if args.origin:
        from echoavatar_lab.models.published import read_encodec

        card |= {"data": f"{args.origin}, as published", "licence": "as published"}
        read_encodec(args.origin).save(args.output, card | {"kind": "codec"})
        return
    codec = settings.checked(CodecConfig, "model")
    config = settings.checked(CodecTrainingConfig, "training", codec=codec)
    corpus = Corpus(args.source)
    heard = [entry.name for entry in corpus.entries("train", has_mirrored=False) if entry.has_sound]
    groups = [AudioGroup(args.source.name, tuple(corpus.sound(name) for name in heard))]
    if args.recordings:
        groups += read_groups(args.recordings)
    start = AudioCodec.load(args.start) if args.start else None
    train_codec(config, args.output, AudioPool(groups), card=card, start=start, **how)
