"""`echoavatar train warp`: trains the model that times motion, on the corpus's stresses and beats."""

import argparse
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options, seed: str) -> None:
    """Declare the arguments that only this model has."""
    options.add("--steps", "training.steps", 2000, type=int, help="optimiser steps")
    options.add("--batch", "training.batch", 24, type=int, help="windows per step")
    options.add("--rate", "training.learning_rate", 2e-3, type=float, help="peak learning rate")
    options.add("--seed", "training.seed", 0, type=int, help=seed)
    options.add_minutes()


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the clips of split "train" without mirrored ones, which have the same audio."""
    from echoavatar.data import Corpus
    from echoavatar.models.warp import WarpConfig
    from echoavatar.models.warp.recipe import WarpTraining
    from echoavatar.models.warp.train import train_warp

    corpus = Corpus(args.source)
    train_warp(
        settings.checked(WarpConfig, "model"),
        settings.checked(WarpTraining, "training"),
        [corpus.load(name) for name in corpus.names("train", has_mirrored=False)],
        args.output,
        minutes=args.minutes,
        card=card,
        **how,
    )
