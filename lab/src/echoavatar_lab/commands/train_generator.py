"""`echoavatar train generator`: trains the generator on a folder of codes (`train tokens`)."""

import argparse
from pathlib import Path
from typing import Any

from .recipe import Options, Settings


def add_arguments(parser: argparse.ArgumentParser, options: Options, seed: str) -> None:
    """Declare the arguments that only the generator has."""
    options.add("--steps", "training.steps", 3200, type=int, help="optimiser steps")
    options.add("--batch", "training.batch", 4, type=int, help="windows per step")
    options.add("--rate", "training.learning_rate", 1e-3, type=float, help="peak learning rate")
    options.add(
        "--optimiser",
        "training.optimiser",
        "muon",
        choices=("adamw", "muon"),
        help="optimiser; Muon needs fewer steps, the paper uses adamw",
    )
    options.add("--width", "model.width", 192, type=int, help="channels")
    options.add("--layers", "model.layers", 6, type=int, help="transformer layers")
    options.add(
        "--window", "model.window_chunks", 10, type=int, help="chunks that a position sees; the paper's 4 s are 15"
    )
    options.add(
        "--corruption",
        "training.corruption",
        "hierarchical",
        choices=("hierarchical", "uniform", "none"),
        help="corruption of the motion codes in the context",
    )
    options.add(
        "--blind",
        "training.blind",
        0.2,
        type=float,
        help="share of windows whose context motion is all noise, so that only the audio informs",
    )
    options.add(
        "--out-of-step",
        "training.out_of_step",
        0.15,
        type=float,
        help="share of windows whose context runs early or late, so that the phase must come from the audio",
    )
    options.add(
        "--cue-weight",
        "training.cue_weight",
        0.3,
        type=float,
        help="weight of predicting beats and stresses from the audio, if the corpus has labels",
    )
    options.add(
        "--exemplar",
        "training.exemplar",
        0.0,
        type=float,
        help="share of windows that are given a set of their own codes, so that actions can steer",
    )
    parser.add_argument("--start", type=Path, help="trained generator of the same sizes to begin with")
    parser.add_argument(
        "--qwen", type=Path, metavar="FOLDER", help="Qwen2.5-0.5B-Instruct, to initialise a new run's transformer"
    )
    options.add("--seed", "training.seed", 0, type=int, help=seed)
    options.add_minutes()
    parser.add_argument(
        "--sharded", action="store_true", help="each of several processes holds a share of the weights (FSDP2)"
    )


def train(args: argparse.Namespace, settings: Settings, how: dict[str, Any]) -> None:
    """Train on the token files."""
    from echoavatar.errors import MotionError
    from echoavatar.models.audio import AudioCodec
    from echoavatar.models.generator import Generator, GeneratorConfig
    from echoavatar.models.tokenizer import BodyTokenizer
    from echoavatar.models.tokens import TokenLayout
    from echoavatar_lab.models.generator.train import GeneratorTraining, train_generator
    from echoavatar_lab.models.generator.windows import TokenClip, leveled_of, patience_of

    codec, tokenizer = AudioCodec.load(args.codec), BodyTokenizer.load(args.tokenizer)
    found = [TokenClip.load(path) for path in sorted(args.source.glob("*.npz"))]
    clips = [clip for clip in found if clip.has_truth]
    if found and not clips:
        raise MotionError(
            f"{args.source} holds only motion that a generator made, for `echoavatar align`; a generator learns"
            " from true motion (`echoavatar train tokens`)"
        )
    layout = TokenLayout.compact(
        audio_codes=codec.config.codes,
        motion_layers=tokenizer.config.layers,
        motion_codes=tokenizer.config.codes,
        parts=len(tokenizer.config.parts),
        has_example=settings.model.get("control") == "prompt",
    )
    model, chosen = settings.model, settings.training
    model.setdefault("mlp", 3 * int(model["width"]))
    model.setdefault("exemplar", float(chosen["exemplar"]) > 0)
    chosen.setdefault("chunks", int(model["window_chunks"]) + 6)  # so that the steady stream is trained too
    chosen.setdefault("depth_weights", [0.7**layer for layer in range(layout.motion_layers)])
    heard = {"patience": patience_of(clips), "is_leveled": leveled_of(clips)}
    config = settings.checked(GeneratorConfig, "model", layout=layout, **heard)
    train_generator(
        config,
        settings.checked(GeneratorTraining, "training"),
        clips,
        args.output,
        minutes=args.minutes,
        sharded=args.sharded,
        start=Generator.load(args.start) if args.start else None,
        qwen=args.qwen,
        audio_codebooks=codec.codebooks,
        motion_codebooks=tokenizer.codebooks(),
        **how,
    )
