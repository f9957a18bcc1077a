"""Stages of `echoavatar train` from sound and motion to a generator: their options, data and tasks.

Without a recipe sizes are those of the default bundle, which are read from it.
"""

import argparse
from pathlib import Path
from typing import Any

from echoavatar.config import Config
from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.models.audio import CodecConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import Skeleton, part_sizes
from echoavatar_lab.data import Corpus
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.recordings import AudioGroup, AudioPool, read_groups
from echoavatar_lab.models.audio.train import CodecTask, CodecTrainingConfig
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.generator.train import GeneratorTask, GeneratorTraining
from echoavatar_lab.models.generator.windows import TokenClip, shared_encoding
from echoavatar_lab.models.published import read_encodec
from echoavatar_lab.models.tokenize import TokenSettings, tokenize_corpus
from echoavatar_lab.models.tokenizer.decoder_train import DecoderTask, DecoderTraining
from echoavatar_lab.models.tokenizer.train import (
    TokenizerTask,
    TokenizerTraining,
    as_one_part,
    bundle_training,
    continued,
)
from echoavatar_lab.models.tokenizer.variants import AnyBodyTokenizer
from echoavatar_lab.training import train

from .recipe import Given, Settings, Stage, shipped


def _add_codec(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--recordings",
        type=Path,
        help="folder of recorded speech and music to train on as well, each as often as the corpus; of a"
        " manifest.csv only the split train",
    )
    parser.add_argument("--start", type=Path, help="trained codec of the same sizes (a run, or part of a bundle)")
    parser.add_argument(
        "--from",
        dest="origin",
        metavar="NAME",
        help="take a published EnCodec instead of training: a folder of it, or facebook/encodec_24khz (the paper's)"
        " from the local model cache",
    )


def _train_codec(given: Given) -> None:
    """Train on the audio of the corpus's train split and of the recordings."""
    args, settings = given.args, given.settings
    if args.origin:
        about = given.card | {"data": f"{args.origin}, as published", "licence": "as published"}
        read_encodec(args.origin).save(args.output, about | {"kind": "codec"})
        return
    codec = settings.checked(CodecConfig, "model")
    config = settings.checked(CodecTrainingConfig, "training", codec=codec)
    corpus = Corpus(args.source)
    heard = [entry.name for entry in corpus.entries("train", has_mirrored=False) if entry.has_sound]
    if not heard and not args.recordings:
        raise AudioError(f"no training clip of {args.source} has sound; name recordings of your own (--recordings)")
    groups = [AudioGroup(args.source.name, tuple(corpus.sound(name) for name in heard))]
    if args.recordings:
        groups += read_groups(args.recordings)
    start = AudioCodec.load(args.start) if args.start else None
    train(CodecTask(config, AudioPool(groups), card=given.card), args.output, start=start, **given.how)


def _add_tokenizer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--start", type=Path, help="trained tokenizer of the same sizes to start from")


def _train_tokenizer(given: Given) -> None:
    """Train on the training clips, measure on the test clips."""
    args, settings = given.args, given.settings
    corpus = Corpus(args.source)
    config = body_sizes(settings, corpus.skeleton)
    if not settings.names("training.quantize_from"):
        settings.training["quantize_from"] = min(int(settings.training["steps"]) // 10, 100)
    training = settings.checked(TokenizerTraining, "training")
    training = training.model_copy(update={"is_mirrored": training.is_mirrored and corpus.can_mirror})
    start = AnyBodyTokenizer.load(args.start) if args.start else None
    training = continued(training) if start else training
    train(
        TokenizerTask(config, training, corpus.motions("train"), tests=corpus.motions("test"), card=given.card),
        args.output,
        start=start,
        **given.how,
    )


def body_sizes(settings: Settings, skeleton: Skeleton) -> BodyTokenizerConfig:
    """Sizes common to all parts, with those that `model.parts` sets for single ones (look-back, heads, codebook decay).

    With `model.is_whole` the body is a single part.
    """
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


def _add_decoder(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--tokenizer", type=Path, required=True, help="trained tokenizer; its codes keep their meaning")


def _train_decoder(given: Given) -> None:
    """Train on the training clips, measure on the test clips."""
    args, corpus = given.args, Corpus(given.args.source)
    training = given.settings.checked(DecoderTraining, "training")
    training = training.model_copy(update={"is_mirrored": training.is_mirrored and corpus.can_mirror})
    train(
        DecoderTask(
            AnyBodyTokenizer.load(args.tokenizer),
            training,
            corpus.motions("train"),
            tests=corpus.motions("test"),
            card=given.card,
            progress=given.how["progress"],
        ),
        args.output,
        **given.how,
    )


def _add_tokens(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dancer",
        type=Path,
        help="trained generator that dances in place of the corpus; a generator that starts from it keeps its dances",
    )
    _add_parts(parser)


def _make_tokens(given: Given) -> None:
    args, corpus = given.args, Corpus(given.args.source)
    settings = given.settings.checked(TokenSettings, "training")
    tokenize_corpus(
        corpus,
        AudioCodec.load(args.codec).eval(),
        AnyBodyTokenizer.load(args.tokenizer).eval(),
        args.output,
        is_mirrored_too=settings.is_mirrored and corpus.can_mirror,
        patience=settings.patience,
        is_leveled=settings.is_leveled,
        dancer=Generator.load(args.dancer).eval() if args.dancer else None,
        progress=given.how["progress"],
    )


def _add_generator(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--start", type=Path, help="trained generator of the same sizes to begin with")
    parser.add_argument(
        "--qwen", type=Path, metavar="FOLDER", help="Qwen2.5-0.5B-Instruct, to initialise a new run's transformer"
    )
    parser.add_argument("--sharded", action="store_true", help="each process holds a share of the weights (FSDP2)")
    _add_parts(parser)


def _add_parts(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--codec", type=Path, required=True, help="trained codec")
    parser.add_argument("--tokenizer", type=Path, required=True, help="trained tokenizer")


def _train_generator(given: Given) -> None:
    """Train on the token files."""
    args, settings = given.args, given.settings
    codec, tokenizer = AudioCodec.load(args.codec), AnyBodyTokenizer.load(args.tokenizer)
    found = [TokenClip.load(path) for path in sorted(args.source.glob("*.npz"))]
    clips = [clip for clip in found if clip.has_truth]
    if found and not clips:
        raise MotionError(
            f"{args.source} holds only motion that a generator made, for `echoavatar align`; a generator learns"
            " from true motion (`echoavatar train tokens`)"
        )
    complete(settings, tokenizer.config.layers)
    layout = compact_layout(
        audio_codes=codec.config.codes,
        motion_layers=tokenizer.config.layers,
        motion_codes=tokenizer.config.codes,
        parts=len(tokenizer.config.parts),
        has_example=settings.model.get("control") == "prompt",
    )
    train(
        GeneratorTask(
            settings.checked(GeneratorConfig, "model", layout=layout, **shared_encoding(clips)),
            settings.checked(GeneratorTraining, "training"),
            clips,
            audio_codebooks=codec.codebooks,
            motion_codebooks=tokenizer.codebooks(),
        ),
        args.output,
        sharded=args.sharded,
        start=Generator.load(args.start) if args.start else args.qwen,
        **given.how,
    )


def complete(settings: Settings, motion_layers: int) -> None:
    """Fill in what follows from other settings of a generator; heads and MLP of the default go with its width only."""
    model, training = settings.model, settings.training
    if settings.names("model.width"):
        for name in ("heads", "kv_heads", "mlp"):
            if not settings.names(f"model.{name}"):
                model.pop(name, None)
        model.setdefault("mlp", 3 * int(model["width"]))
    model.setdefault("exemplar", float(training["exemplar"]) > 0)
    model.setdefault("manner", float(training.get("manner", 0)) > 0)
    training.setdefault("chunks", int(model["window_chunks"]) + 6)  # so that the steady stream is trained too
    training.setdefault("depth_weights", [0.7**layer for layer in range(motion_layers)])


def stages() -> dict[str, Stage]:
    """The stages by name, in the order of their commands."""
    corpus = "corpus folder (`data rehearse`, `data prepare`)"
    generator, tokenizer = shipped("generator"), shipped("tokenizer")
    heard = {"training": {"patience": generator["patience"]}}
    part: dict[str, Any] = next(iter(tokenizer["parts"].values()))
    tokenizer_base = {
        "model": {name: size for name, size in part.items() if name != "features"},
        "training": bundle_training().model_dump(),
    }
    # What follows from the codes and from the schedule, and the chunk, which goes with a face of as many frames.
    left_out = ("layout", "patience", "is_leveled", "exemplar", "manner", "step")
    generator_base = {
        "model": {name: size for name, size in generator.items() if name not in left_out},
        "training": {
            "steps": 3000,
            "batch": 16,
            "learning_rate": 1.2e-3,
            "optimiser": "muon",
            "corruption": "hierarchical",
            "blind": 0.1,
            "out_of_step": 0.15,
            "other_past": 0.1,
            "cue_weight": 0.3,
            "exemplar": 0.3,
            "manner": 0.0,
        },
    }
    codec_base = {
        "model": shipped("codec"),
        "training": {"steps": 100_000, "minutes": 40.0, "unquantized": 300, "learning_rate": 1.5e-3},
    }
    return {
        "codec": Stage(
            "the audio codec, on the corpus's audio",
            corpus,
            CodecConfig,
            CodecTrainingConfig,
            codec_base,
            ("--minutes training.minutes",),
            _train_codec,
            _add_codec,
        ),
        "tokenizer": Stage(
            "the motion tokenizer, on the corpus's motion",
            corpus,
            MotionTokenizerConfig,
            TokenizerTraining,
            tokenizer_base,
            ("--steps training.steps",),
            _train_tokenizer,
            _add_tokenizer,
        ),
        "decoder": Stage(
            "a trained tokenizer's decoder, on the steady codes that a generator learns",
            corpus,
            Config,
            DecoderTraining,
            heard,
            ("--steps training.steps", "--patience training.patience"),
            _train_decoder,
            _add_decoder,
        ),
        "tokens": Stage(
            "encode the corpus with a trained codec and tokenizer",
            corpus,
            Config,
            TokenSettings,
            heard,
            ("--patience training.patience", "--no-level training.is_leveled", "--no-mirror training.is_mirrored"),
            _make_tokens,
            _add_tokens,
        ),
        "generator": Stage(
            "the generator, on a folder of codes",
            "folder of codes (`train tokens`)",
            GeneratorConfig,
            GeneratorTraining,
            generator_base,
            (
                *("--steps training.steps", "--batch training.batch", "--rate training.learning_rate"),
                *("--optimiser training.optimiser", "--seed training.seed", "--corruption training.corruption"),
                *("--blind training.blind", "--out-of-step training.out_of_step", "--cue-weight training.cue_weight"),
                *("--exemplar training.exemplar", "--width model.width", "--layers model.layers"),
                "--window model.window_chunks",
            ),
            _train_generator,
            _add_generator,
        ),
    }
