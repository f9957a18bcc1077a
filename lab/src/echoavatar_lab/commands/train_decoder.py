"""`echoavatar train decoder`: trains the decoder of a trained tokenizer on the steady codes that a generator learns."""

import argparse
from pathlib import Path
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only the decoder has."""
    parser.add_argument("--tokenizer", type=Path, required=True, help="trained tokenizer; its codes keep their meaning")
    options.add("--steps", "training.steps", 3000, type=int, help="optimiser steps")
    options.add("--patience", "training.patience", 0.4, type=float, help="as given to `train tokens`")
    options.add_minutes()


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the training clips, measure on the test clips."""
    from echoavatar.models.tokenizer import BodyTokenizer
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.models.tokenizer.decoder_train import DecoderTraining, train_decoder

    corpus = Corpus(args.source)
    training = settings.checked(DecoderTraining, "training")
    training = training.model_copy(update={"is_mirrored": training.is_mirrored and corpus.can_mirror})
    clips, tests = (
        [corpus.motion(name) for name in corpus.names(split, has_mirrored=False)] for split in ("train", "test")
    )
    start = BodyTokenizer.load(args.tokenizer)
    train_decoder(start, training, clips, tests, args.output, card=card, minutes=args.minutes, **how)
