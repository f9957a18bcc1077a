"""`echoavatar train fid-encoder`: the extractor that `echoavatar score` takes FID with, on a corpus's motion."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from tqdm import tqdm

from ..errors import EchoAvatarError

if TYPE_CHECKING:
    from torch import Tensor

    from ..data import Corpus

EXAMPLES = """examples:
  echoavatar train fid-encoder corpus -o runs/fid                 some minutes on one core
  echoavatar train fid-encoder corpus -o runs/fid --minutes 1     stop after one; call again to go on
then: echoavatar score made true --extractor runs/fid
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that only the extractor has."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EXAMPLES
    parser.add_argument("--steps", type=int, default=1500, help="optimiser steps (default: %(default)s)")
    parser.add_argument("--width", type=int, default=64, help="channels (default: %(default)s)")
    parser.add_argument(
        "--latent", type=int, default=48, help="features that FID is taken of (default: %(default)s)"
    )
    parser.add_argument(
        "--minutes", type=float, help="stop this call after so many minutes; call again to go on"
    )


def train(args: argparse.Namespace, card: dict[str, object], progress: Callable[[int, int], None]) -> None:
    """Train on the corpus's training clips, then say how much of its test clips comes back."""
    from .. import checkpoint
    from ..data import Corpus
    from ..metrics.motion_encoder import MotionEncoderConfig
    from ..metrics.motion_encoder_train import MotionEncoderTraining, explained, train_motion_encoder

    corpus = Corpus(args.source)
    clips = _features(corpus, "train")
    if not clips:
        raise EchoAvatarError(f"{args.source} has no training clips; make a longer corpus")
    model = train_motion_encoder(
        MotionEncoderConfig(width=args.width, latent=args.latent),
        MotionEncoderTraining(steps=args.steps),
        clips,
        args.output,
        minutes=args.minutes,
        card=card,
        progress=progress,
    )
    scores = {"explained_train": round(explained(model, clips[:32]), 4)}
    if tests := _features(corpus, "test"):
        scores["explained_test"] = round(explained(model, tests), 4)
    model.save(args.output, checkpoint.read_card(args.output) | {"scores": scores})


def _features(corpus: "Corpus", split: str) -> "list[Tensor]":
    import torch

    from ..metrics.motion_features import motion_features

    motions = (
        corpus.motion(name) for name in tqdm(corpus.names(split), desc="reading", unit="clip", leave=False)
    )
    return [motion_features(torch.from_numpy(m.rotations), torch.from_numpy(m.root)) for m in motions]
