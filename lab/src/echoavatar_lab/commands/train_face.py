"""`echoavatar train face`: trains the face model on pairs of audio and ARKit curves (`data face`)."""

import argparse
from pathlib import Path
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options, seed: str) -> None:
    """Declare the arguments that only the face has."""
    options.add("--steps", "training.steps", 8000, type=int, help="optimiser steps")
    options.add("--batch", "training.batch", 32, type=int, help="windows per step")
    options.add("--rate", "training.learning_rate", 1e-3, type=float, help="peak learning rate; paper: 2e-4")
    options.add("--listen", "training.listen", 0, type=int, help="number of first steps that train the encoder alone")
    options.add(
        "--no-tempo",
        "training.tempo",
        True,
        action="store_true",
        help="no slower and faster copies; rehearsed clips differ in pace anyway, and this saves much memory",
    )
    parser.add_argument("--start", type=Path, help="trained face model of the same sizes to start from")
    options.add("--seed", "training.seed", 0, type=int, help=seed)
    parser.add_argument(
        "--hubert",
        type=Path,
        metavar="FOLDER",
        help="pretrained HuBERT (transformers' config.json and weights) as the encoder, kept as it is; the paper's is "
        "multilingual, with 768 channels. Goes with --recipe lab/recipes/paper/face.yaml or --paper",
    )
    parser.add_argument("--paper", action="store_true", help="sizes of the paper (width 256), mel encoder")
    options.add_minutes()


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the face clips."""
    from echoavatar.models.face import FaceConfig, FaceModel, MelConfig, paper_face
    from echoavatar_lab.models.face.clip import load_clips
    from echoavatar_lab.models.face.train import FaceTraining, train_face

    if args.paper:
        settings = args.options.settings(args, {"model": paper_face(encoder=MelConfig()).model_dump()})
    encoder = None
    if args.hubert:
        from echoavatar_lab.models.published import read_hubert

        encoder = read_hubert(args.hubert)
        settings.model["encoder"] = encoder.config.model_dump()
    train_face(
        settings.checked(FaceConfig, "model"),
        settings.checked(FaceTraining, "training"),
        load_clips(args.source),
        args.output,
        minutes=args.minutes,
        start=FaceModel.load(args.start) if args.start else None,
        encoder=encoder,
        card=card,
        **how,
    )
