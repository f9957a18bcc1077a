"""`echoavatar train fid-encoder`: trains the extractor of `echoavatar score`'s FID on a corpus's motion."""

import argparse
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError

from .recipe import Options, Settings

if TYPE_CHECKING:
    from torch import Tensor

    from echoavatar_lab.data import Corpus

EXAMPLES = """examples:
  echoavatar train fid-encoder corpus -o runs/fid                 some minutes on one core
  echoavatar train fid-encoder corpus -o runs/fid --minutes 1     stop after one; call again to resume
then: echoavatar score made true --extractor runs/fid
"""


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only the extractor has."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EXAMPLES
    options.add("--steps", "training.steps", 1500, type=int, help="optimiser steps")
    options.add("--width", "model.width", 64, type=int, help="channels")
    options.add("--latent", "model.latent", 48, type=int, help="size of a latent, the features of FID")
    options.add_minutes()


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the corpus's training clips, then measure how much variance of its test clips the latents preserve."""
    from echoavatar import checkpoint
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoderConfig
    from echoavatar_lab.evaluation.metrics.motion_encoder_train import (
        MotionEncoderTraining,
        explained_variance,
        train_motion_encoder,
    )

    config = settings.checked(MotionEncoderConfig, "model")
    training = settings.checked(MotionEncoderTraining, "training")
    corpus = Corpus(args.source)
    clips = _features(corpus, "train")
    if not clips:
        raise EchoAvatarError(f"{args.source} has no training clips; make a longer corpus")
    model = train_motion_encoder(config, training, clips, args.output, minutes=args.minutes, card=card, **how)
    scores = {"explained_train": round(explained_variance(model, clips[:32]), 4)}
    if tests := _features(corpus, "test"):
        scores["explained_test"] = round(explained_variance(model, tests), 4)
    model.save(args.output, checkpoint.read_card(args.output) | {"scores": scores})


def _features(corpus: "Corpus", split: str) -> "list[Tensor]":
    import torch

    from echoavatar_lab.evaluation.metrics.motion_encoder import motion_features

    motions = (corpus.motion(name) for name in tqdm(corpus.names(split), desc="reading", unit="clip", leave=False))
    return [motion_features(torch.from_numpy(m.rotations), torch.from_numpy(m.root)) for m in motions]
