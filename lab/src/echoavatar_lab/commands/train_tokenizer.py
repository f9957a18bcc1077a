"""`echoavatar train tokenizer`: trains the motion tokenizer of all body parts on a corpus's motion."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from echoavatar.errors import EchoAvatarError

from .recipe import Options, Settings

if TYPE_CHECKING:
    from echoavatar.models.tokenizer import BodyTokenizerConfig
    from echoavatar.motion.kinematics import Skeleton


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only the tokenizer has."""
    options.add("--steps", "training.steps", 6000, type=int, help="optimiser steps")
    parser.add_argument("--start", type=Path, help="trained tokenizer of the same sizes to start from")
    options.add_minutes()


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train on the training clips, measure on the test clips."""
    from echoavatar.models.tokenizer import BodyTokenizer
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.models.tokenizer.train import (
        BUNDLE_SIZES,
        TokenizerTraining,
        bundle_recipe,
        continued,
        train_tokenizer,
    )

    corpus = Corpus(args.source)
    _, bundle = bundle_recipe(corpus.skeleton, int(settings.training["steps"]))
    base = {"model": BUNDLE_SIZES.model_dump(exclude={"features"}), "training": bundle.model_dump()}
    settings = args.options.settings(args, base)
    config = body_sizes(settings, corpus.skeleton)
    training = settings.checked(TokenizerTraining, "training")
    training = training.model_copy(update={"is_mirrored": training.is_mirrored and corpus.can_mirror})
    clips = [corpus.motion(name) for name in corpus.names("train", has_mirrored=False)]  # mirrored window by window
    tests = [corpus.motion(name) for name in corpus.names("test", has_mirrored=False)]
    start = BodyTokenizer.load(args.start) if args.start else None
    training = continued(training) if start else training
    train_tokenizer(config, training, clips, tests, args.output, card=card, start=start, minutes=args.minutes, **how)


def body_sizes(settings: Settings, skeleton: "Skeleton") -> "BodyTokenizerConfig":
    """Sizes common to all parts, with those that `model.parts` sets for single ones (look-back, heads, codebook decay).

    With `model.is_whole` the body is a single part.
    """
    from echoavatar.models.tokenizer import BodyTokenizerConfig, MotionTokenizerConfig, as_one_part
    from echoavatar.motion.kinematics import part_sizes

    common = dict(settings.model)
    if common.pop("is_whole", False):
        skeleton = as_one_part(skeleton)
    own: dict[str, Any] = common.pop("parts", {})
    features = part_sizes(skeleton)
    if unknown := own.keys() - features.keys():
        parts = ", ".join(features)
        raise EchoAvatarError(
            f"{settings.origin}: model.parts.{min(unknown)} is no part of the body; there are {parts}"
        )
    sizes = {
        name: settings._replace(model=common | own.get(name, {})).checked(
            MotionTokenizerConfig, "model", features=count
        )
        for name, count in features.items()
    }
    if len({(size.width, size.layers, size.codes) for size in sizes.values()}) > 1:
        raise EchoAvatarError(f"{settings.origin}: model.parts may not differ in width, layers or codes")
    return BodyTokenizerConfig(skeleton=skeleton.config, parts=sizes)
