"""`echoavatar align targets`: tune a generator until it keeps time, moves enough, and is taken for a person."""

import argparse
from pathlib import Path

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError

EXAMPLES = """examples:
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --device cuda
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --device cuda --generator runs/mix --minutes 9
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --batch 8 --length 28 --steps 20      a try on a CPU

TOKENS is a folder of codes that the bundle's own codec and tokenizer made (`echoavatar train tokens`), CAPTURED one of
captured dancers as for `evaluate BUNDLE alive`, which may train what you do with the weights. GRPO with rewards that
follow targets: the generator is to keep time and to move as much as the bundle's own (or --like), and a classifier
that learns along is to take it for a person. 512 continuations of 10 s are a step: some two seconds on an H200,
minutes on a CPU, where `align grpo` is the better choice. A run that was stopped resumes when the command is called
again. See docs/alignment.md.
"""
SETTINGS = {
    "steps": (int, 180, "optimiser steps"),
    "batch": (int, 64, "prompts a step"),
    "group": (int, 8, "continuations of each prompt"),
    "past": (int, 64, "chunks of motion before a continuation, at least 5; the last 22 are kept"),
    "own-past": (int, 56, "chunks of that past which the policy makes itself"),
    "length": (int, 38, "chunks of a continuation, one window for the classifier; at least 28"),
    "learning-rate": (float, 1.5e-4, "learning rate of AdamW"),
    "kl-weight": (float, 0.04, "weight of the divergence from the reference"),
    "layers": (int, 3, "RVQ layers, coarsest first, that rewards are credited to"),
    "accumulation": (int, 4, "pieces that a batch is split into, to save memory"),
    "save-every": (int, 20, "steps between checkpoints"),
    "seed": (int, 0, "seed of prompts and sampled codes"),
}
SAMPLING = {"temperature": "sampling temperature", "cooling": "cooling by RVQ layer", "top-p": "nucleus"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument("source", type=Path, metavar="TOKENS", help="folder of codes (`train tokens`)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")
    parser.add_argument("--captured", type=Path, required=True, help="captured clips, as for `evaluate BUNDLE alive`")
    parser.add_argument("--model", default="default", help="bundle to tune (default: %(default)s)")
    parser.add_argument("--generator", type=Path, help="trained generator instead of the bundle's")
    parser.add_argument("--like", type=Path, help="generator that sets the targets (default: the bundle's)")
    parser.add_argument("--device", default="cpu", help="(default: %(default)s)")
    parser.add_argument("--minutes", type=float, help="stop this call after so many minutes; call again to resume")
    for name, text in SAMPLING.items():
        parser.add_argument(f"--{name}", type=float, help=f"{text} to tune for; saved (default: the generator's)")
    for name, (kind, value, text) in SETTINGS.items():
        parser.add_argument(f"--{name}", type=kind, default=value, help=f"{text} (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Tune."""
    for name, least, why in (("past", 5, "the decoder's memory"), ("length", 28, "as `novelty` compares seconds")):
        if getattr(args, name) < least:
            raise EchoAvatarError(f"--{name} {getattr(args, name)} is too short: at least {least} chunks, {why}")
    from echoavatar.checkpoint import read_card
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar.models.generator import Generator
    from echoavatar_lab.align.config import AlignTraining
    from echoavatar_lab.align.prompts import read_token_clips
    from echoavatar_lab.align.start import tune
    from echoavatar_lab.align.trainer import RunContext
    from echoavatar_lab.align.tuning.goals import Targets, targets_like
    from echoavatar_lab.align.tuning.judge import TargetJudge
    from echoavatar_lab.align.tuning.task import (
        PromptsByKind,
        TargetTask,
        means_like,
        people_in_music,
        people_in_speech,
    )
    from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, SPEECH
    from echoavatar_lab.evaluation.takes import read_captured

    bundle = load_bundle(args.model)
    tokenizer = bundle.tokenizer.to(args.device)
    policy = Generator.load(args.generator) if args.generator else bundle.generator
    given = {name.replace("-", "_"): getattr(args, name.replace("-", "_")) for name in SAMPLING}
    policy.config = policy.config.model_copy(update={name: v for name, v in given.items() if v is not None})
    reference = Generator(policy.config)
    reference.load_state_dict(policy.state_dict())
    like = (Generator.load(args.like) if args.like else load_bundle(args.model).generator).to(args.device)
    chosen = {name.replace("-", "_"): getattr(args, name.replace("-", "_")) for name in SETTINGS}
    training = AlignTraining.model_validate(
        chosen
        | {"betas": (0.9, 0.98), "average": 0.97, "warmup": 8, "autocast": True, "kl_stop": 2, "evaluate_every": 0}
    )
    clips = read_token_clips(args.source, policy.config.layout, needs_truth=True)
    train = {name: clip for name, clip in clips.items() if clip.split == "train"}
    book = PromptsByKind(
        train, past=training.past, length=training.length, seed=training.seed, fewest_events=training.fewest_events
    )
    people = {
        MUSIC: people_in_music(read_captured(args.captured), training.length),
        SPEECH: people_in_speech(tokenizer, book, args.device),
    }
    kept = args.output / "targets.json"  # a resumed run keeps the targets that it began with
    if kept.exists():
        targets = Targets.model_validate_json(kept.read_bytes()).targets
    else:
        targets = targets_like(means_like(like, tokenizer, book, training))
        args.output.mkdir(parents=True, exist_ok=True)
        kept.write_text(Targets(targets=targets).model_dump_json(indent=1) + "\n", encoding="utf-8")
    begun = read_card(args.generator) if args.generator else bundle.card
    card = {"data": str(args.source), "licence": begun.get("licence", "Apache-2.0")}
    card |= {"begun_from": str(args.generator or args.model)}
    context = RunContext(card=card, reference_name=str(args.generator or args.model))
    task = TargetTask(policy, reference, training, TargetJudge(tokenizer, people, targets), context, book=book)
    with tqdm(unit="step", smoothing=0.05) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        stopped = tune(task, args.output, device=args.device, minutes=args.minutes, progress=progress)
    print(f"stopped: {stopped}; {args.output} holds the last checkpoint before" if stopped else f"in {args.output}")
    return 0
