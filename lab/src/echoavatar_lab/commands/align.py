"""`echoavatar align`: reinforcement learning of a generator (GRPO, DPO, PPO), rollouts, soups, reward models."""

import argparse
import json
import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from echoavatar.cli.options import seed
from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.stored import read_card
from echoavatar.whole_file import write_whole
from echoavatar_lab import paper
from echoavatar_lab.align.compare import as_markdown, compare, over_seeds
from echoavatar_lab.align.policy import Sampling, soup
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import parse_weights
from echoavatar_lab.align.start import AlignmentSetup, load_setup, make_pairs, training_task, tune
from echoavatar_lab.align.target_task import target_task
from echoavatar_lab.align.trainer import AlignTraining, recipe
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.evaluation.people import read_people
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.progress import Progress, progress_bar

from . import align_rewards
from .config_options import add_fields, add_minutes, add_track, command_line, given_fields

EXAMPLES = """examples:
  echoavatar align grpo TOKENS -o runs/grpo                        tune the default bundle's generator to the audio
  echoavatar align grpo TOKENS -o runs/grpo --reward beat_alignment=1 --reward stillness=0.5 --minutes 30
  echoavatar align rollouts TOKENS -o pairs.jsonl --group 8        best and worst of eight, by reward
  echoavatar align dpo TOKENS -o runs/dpo --pairs pairs.jsonl
  echoavatar align ppo TOKENS -o runs/ppo --recipe tiny
  echoavatar align compare TOKENS -o it.json --beside runs/grpo    what tuning gained and what it cost
  echoavatar align soup runs/a=0.5 runs/b=0.5 -o runs/mix          a mix of two runs from the same generator
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED              as the default bundle was tuned
  echoavatar align calibrate TOKENS -o scores.json                 scores of corruption levels from your own FID
  echoavatar align reward-quality TOKENS -o runs/quality           how good motion looks
  echoavatar align reward-alignment TOKENS -o runs/alignment       how well motion fits the audio
  echoavatar align reward-realism TOKENS --captured CAPTURED -o realism.json     how surely a body is a person's

TOKENS is a folder of codes that the bundle's own codec and tokenizer made (`echoavatar train tokens`).
Methods, rewards of your own, recipes: docs/alignment.md.
"""
TARGETS = """examples:
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --device cuda
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --device cuda --generator runs/mix --minutes 9
  echoavatar align targets TOKENS -o runs/tuned --captured CAPTURED --batch 8 --length 28 --steps 20      a try on a CPU

TOKENS is a folder of codes that the bundle's own codec and tokenizer made (`echoavatar train tokens`), CAPTURED one of
captured dancers as for `evaluate BUNDLE alive`, which may train what you do with the weights. GRPO with rewards that
follow targets: the generator is to keep time and to move as much as the bundle's own (or --like), and a classifier that
learns along is to take it for a person. 512 continuations of 10 s are a step: some two seconds on an H200, minutes on a
CPU, where `align grpo` is the better choice. --past is at least 5 chunks, of which the last 22 are kept. --length is at
least 28: one window for the classifier. A run that was stopped resumes when the command is called again. See
docs/alignment.md.
"""

RECIPES = ("tiny", "rehearsal", "paper")
CANDIDATES = 8  # of which best and worst are kept (paper, Direct Preference Alignment)
PAPER_REWARDS = [f"{name}={weight:g}" for name, weight in paper.REWARDS.items()]
SIZES = ("group", "past", "length", "fewest_events")
SAMPLING = ("temperature", "cooling", "top_p")
TARGET_SETTINGS = (
    *("steps", "batch", *SIZES[:3], "own_past", "learning_rate", "kl_weight", "layers"),
    *("accumulation", "save_every", "seed"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    grpo = kinds.add_parser("grpo", help="compare the continuations of a prompt with each other")
    dpo = kinds.add_parser("dpo", help="learn from preferred and rejected continuations")
    ppo = kinds.add_parser("ppo", help="learn with a value head that predicts the reward")
    dpo.add_argument("--pairs", type=Path, required=True, help="JSONL of pairs (`align rollouts`, the studio)")
    dpo.add_argument("--margin", type=float, default=0.0, help="skip pairs that differ by less (default: %(default)s)")
    for child in (grpo, ppo):
        child.add_argument(
            "--rollouts",
            metavar="MODULE:FUNCTION",
            help="backend that draws continuations instead of the generator itself (docs/alignment.md)",
        )
    _add_rollouts(kinds.add_parser("rollouts", help="best and worst continuation by reward, as pairs for DPO"))
    _add_compare(kinds.add_parser("compare", help="compare generators on held-out prompts"))
    _add_soup(kinds.add_parser("soup", help="mix generators that were tuned from the same one"))
    _add_targets(
        kinds.add_parser(
            "targets",
            help="GRPO until a generator keeps time, moves enough and passes for a person",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            epilog=TARGETS,
        )
    )
    align_rewards.add_arguments(kinds)
    for child in (grpo, dpo, ppo):
        _add_common(child)
        child.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")
        child.add_argument("--recipe", choices=RECIPES, default="rehearsal", help="(default: %(default)s)")
        add_fields(child, AlignTraining, _settings(), default="the recipe's")
        child.add_argument(
            "--autocast", action="store_true", help="multiply in bfloat16 on processors that are fast at it"
        )
        add_track(child)
        add_minutes(child)


def _settings() -> list[str]:
    """The settings of a method that are options: those that `AlignTraining` itself declares."""
    return [name for name in AlignTraining.model_fields if name in AlignTraining.__annotations__ and name != "method"]


def _add_rollouts(child: argparse.ArgumentParser) -> None:
    _add_common(child)
    child.add_argument("-o", "--output", type=Path, required=True, metavar="JSONL", help="file to write")
    child.add_argument("--prompts", type=int, default=200, help="number of prompts (default: %(default)s)")
    child.add_argument("--recipe", choices=RECIPES, default="rehearsal", help="of the sizes (default: %(default)s)")
    add_fields(child, AlignTraining, SIZES, default=dict.fromkeys(SIZES, "the recipe's") | {"group": CANDIDATES})
    child.add_argument("--margin", type=float, default=0.5, help="least difference in a pair (default: %(default)s)")
    child.add_argument("--seed", type=seed, default=0, help="seed of prompts and codes (default: %(default)s)")


def _add_compare(child: argparse.ArgumentParser) -> None:
    _add_common(child)
    child.add_argument(
        "--beside",
        type=Path,
        nargs="+",
        action="append",
        default=[],
        metavar="FOLDER",
        help="tuned generator, or runs of one method with several seeds, which share a line; may be repeated",
    )
    child.add_argument("--prompts", type=int, default=48, help="held-out prompts (default: %(default)s)")
    child.add_argument("--group", type=int, default=4, help="continuations of each (default: %(default)s)")
    child.add_argument("--past", type=int, default=3, help="chunks of past (default: %(default)s)")
    child.add_argument("--length", type=int, default=9, help="chunks in a continuation (default: %(default)s)")
    child.add_argument("--seed", type=seed, default=0, help="seed of sampling (default: %(default)s)")
    child.add_argument("-o", "--output", type=Path, required=True, metavar="JSON", help="file to write")


def _add_soup(child: argparse.ArgumentParser) -> None:
    child.add_argument("runs", nargs="+", metavar="FOLDER=SHARE", help="tuned generator and its share, such as 0.5")
    child.add_argument("-o", "--output", type=Path, required=True, help="folder for the mix")
    child.add_argument("--model", default="default", help="bundle that the runs began with (default: %(default)s)")
    child.add_argument("--generator", type=Path, help="generator that they began with, instead of the bundle's")


def _add_targets(child: argparse.ArgumentParser) -> None:
    child.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")
    child.add_argument("--captured", type=Path, required=True, help="captured clips, as for `evaluate BUNDLE alive`")
    child.add_argument("--like", type=Path, help="generator that sets the targets (default: the bundle's)")
    _add_policy(child)
    add_minutes(child)
    add_fields(child, AlignTraining, TARGET_SETTINGS, default=recipe("targets", "grpo").model_dump())


def _add_policy(child: argparse.ArgumentParser) -> None:
    """Declare the options of the tuned generator, of its sampling, and of the device."""
    child.add_argument("source", type=Path, metavar="TOKENS", help="folder of codes (`train tokens`)")
    child.add_argument("--model", default="default", help="bundle to tune (default: %(default)s)")
    child.add_argument("--generator", type=Path, help="trained generator instead of the bundle's")
    add_fields(child, Sampling, SAMPLING, default="the generator's")
    child.add_argument("--device", default="cpu", help="(default: %(default)s)")


def _add_common(child: argparse.ArgumentParser) -> None:
    _add_policy(child)
    child.add_argument("--reference", type=Path, help="generator to stay near (default: the one tuned)")
    child.add_argument(
        "--reward",
        action="append",
        metavar="NAME=WEIGHT",
        help="a component of the reward, also MODULE:FUNCTION=WEIGHT; may be repeated (default: "
        "beats=1 stresses=1 liveliness=0.3 smoothness=0.1 planted_feet=0.1 stillness=0.5; with --recipe paper quality=1"
        " alignment=1)",
    )
    child.add_argument("--reference-statistics", type=Path, help="statistics of true motion (default: measured now)")
    child.add_argument(
        "--earlier",
        type=int,
        default=0,
        metavar="FRAMES",
        help="pay for strokes on stresses that come so much before the truth's (default: 0)",
    )
    child.add_argument("--quality", type=Path, help="trained quality reward, for --reward quality=1")
    child.add_argument("--alignment", type=Path, help="trained alignment reward, for --reward alignment=1")
    child.add_argument("--realism", type=Path, metavar="JSON", help="fitted realism reward, for --reward realism=0.04")


def run(args: argparse.Namespace) -> int:
    """Run one of the sub-commands."""
    if args.kind in align_rewards.KINDS:
        return align_rewards.run(args)
    if args.kind == "soup":
        return _soup(args)
    if args.kind == "compare":
        return _compare(args, _setup(args))
    with progress_bar() as say:
        told = {"rollouts": _rollouts, "targets": _targets}.get(args.kind, _train)(args, partial(say, args.kind))
    if os.environ.get("RANK", "0") == "0":
        print(told)
    return 0


def _setup(args: argparse.Namespace) -> AlignmentSetup:
    if args.reward is None and args.kind in ("grpo", "ppo", "rollouts") and args.recipe == "paper":
        args.reward = PAPER_REWARDS
    return load_setup(
        args.source,
        args.output.parent if args.kind in ("rollouts", "compare") else args.output,
        bundle=args.model,
        generator=args.generator,
        reference=args.reference,
        rewards=args.reward,
        reference_statistics=args.reference_statistics,
        earlier=args.earlier,
        quality=args.quality,
        alignment=args.alignment,
        realism=args.realism,
        sampling=given_fields(args, SAMPLING),
        is_compared=args.kind == "dpo",
    )


def _rollouts(args: argparse.Namespace, progress: Progress) -> str:
    base = recipe(args.recipe, "dpo").model_copy(update={"group": CANDIDATES})
    training, rest = _training(args, base, (*SIZES, "seed")), {"prompts": args.prompts, "margin": args.margin}
    return f"{make_pairs(_setup(args), args.output, training, **rest, progress=progress)} pairs in {args.output}"


def _train(args: argparse.Namespace, progress: Progress) -> str:
    ready = _setup(args)
    base = recipe(args.recipe, args.kind).model_copy(update={"autocast": args.autocast})
    training = _training(args, base, _settings())
    names = ("pairs", "margin") if args.kind == "dpo" else ("rollouts",)
    given = {name: getattr(args, name) for name in names}
    task = training_task(args.kind, training, ready, command=command_line(args), **given)
    how = {"device": args.device, "minutes": args.minutes, "trackers": args.track, "progress": progress}
    return _ended(args, tune(task, args.output, **how))


def _training(args: argparse.Namespace, base: AlignTraining, names: Iterable[str]) -> AlignTraining:
    return base.model_validate(base.model_dump() | given_fields(args, names))


def _ended(args: argparse.Namespace, stopped: str) -> str:
    if stopped:
        return f"stopped: {stopped}; {args.output} holds the last checkpoint before"
    return f"{args.kind} in {args.output}"


def _compare(args: argparse.Namespace, ready: AlignmentSetup) -> int:
    """Compare generators on held-out prompts; write JSON and a table, print the JSON."""
    if not ready.test:
        raise MotionError(f"{args.source} holds no clip of split test, so there is nothing to measure on")
    prompts = PromptSampler(ready.test, past=args.past, length=args.length).spread(args.prompts)
    generators = {"untuned": ready.generator} | {
        str(folder): Generator.load(folder) for folders in args.beside for folder in folders
    }
    how = {"group": args.group, "seed": args.seed, "device": args.device}
    found = compare(generators, ready.tokenizer, prompts, ready.mix, load_shipped(), **how)
    lines = {
        ", ".join(map(str, folders)): over_seeds(found["untuned"], [found[str(folder)] for folder in folders])
        for folders in args.beside
    }
    told = {"prompts": len(prompts), "group": args.group, "seed": args.seed, "found": found, "over_seeds": lines}
    write_whole(args.output, json.dumps(told) + "\n")
    write_whole(args.output.with_suffix(".md"), as_markdown(found, lines))
    print(json.dumps(told))
    return 0


def _soup(args: argparse.Namespace) -> int:
    """Mix generators that were tuned from the same one, and save the mix."""
    shares = parse_weights(args.runs, "run", "runs/a=0.5")
    start = Generator.load(args.generator) if args.generator else load_bundle(args.model).generator
    mixed = soup(start, {name: (Generator.load(Path(name)), share) for name, share in shares.items()})
    cards = {name: read_card(Path(name)) for name in shares}
    about = {"kind": "generator", "begun_from": str(args.generator or args.model), "shares": shares}
    licences = {str(card.get("licence", "unknown")) for card in cards.values()}
    mixed.save(args.output, about | {"licence": " and ".join(sorted(licences)), "runs": cards})
    print(f"{len(shares)} runs mixed in {args.output}")
    return 0


def _targets(args: argparse.Namespace, progress: Progress) -> str:
    """Tune a generator until it keeps time, moves enough, and is taken for a person."""
    training = _training(args, recipe("targets", "grpo"), TARGET_SETTINGS)
    for name, least, why in (("past", 5, "the decoder's memory"), ("length", 28, "as `novelty` compares seconds")):
        if getattr(training, name) < least:
            raise EchoAvatarError(f"--{name} {getattr(training, name)} is too short: at least {least} chunks, {why}")
    task = target_task(
        training,
        args.source,
        args.output,
        read_people(args.captured, for_training=True),
        bundle=args.model,
        generator=args.generator,
        like=args.like,
        sampling=given_fields(args, SAMPLING),
        device=args.device,
    )
    return _ended(args, tune(task, args.output, device=args.device, minutes=args.minutes, progress=progress))
