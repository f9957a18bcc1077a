"""`echoavatar train codec`: trains the audio codec on a corpus's audio and other recordings."""

import argparse
from pathlib import Path
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only the codec has."""
    parser.add_argument("--recordings", type=Path, help="folder of recorded audio to train on as well")
    options.add("--minutes", "training.minutes", 40.0, type=float, help="training time, the schedule fitted to it")


BASE = {"training": {"steps": 100_000, "unquantized": 300, "learning_rate": 1.5e-3}}


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on all audio of the corpus."""
    from echoavatar.data import Corpus
    from echoavatar.models.audio import CodecConfig
    from echoavatar.models.audio.pool import AudioGroup, AudioPool, read_group
    from echoavatar.models.audio.train import CodecTrainingConfig, train_codec

    codec = settings.checked(CodecConfig, "model")
    config = settings.checked(CodecTrainingConfig, "training", codec=codec)
    corpus = Corpus(args.source)
    heard = [entry.name for entry in corpus.entries(has_mirrored=False) if entry.has_sound]
    groups = [AudioGroup(args.source.name, tuple(corpus.sound(name) for name in heard))]
    if args.recordings:
        groups.append(read_group(args.recordings, weight=0.5))
    train_codec(config, args.output, AudioPool(groups), card=card, **how)
