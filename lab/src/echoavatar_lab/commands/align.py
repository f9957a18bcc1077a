"""`echoavatar align`: reinforcement learning of a generator (GRPO, DPO, PPO), rollouts, soups, reward models."""

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from . import align_compare, align_rewards, align_soup, align_targets

if TYPE_CHECKING:
    from echoavatar_lab.align.config import AlignTraining
    from echoavatar_lab.align.start import AlignmentSetup

EXAMPLES = """examples:
  echoavatar align grpo TOKENS -o runs/grpo                        tune the default bundle's generator to the audio
  echoavatar align grpo TOKENS -o runs/grpo --reward beats=1 --reward stillness=0.5 --minutes 30
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

RECIPES = ("tiny", "rehearsal", "paper")
CANDIDATES = 8  # of which best and worst are kept (paper, Direct Preference Alignment)
PAPER_REWARDS = ["quality=1", "alignment=1"]  # paper, Reward-Guided Optimization; how it weighs them it does not say
SETTINGS = {
    "steps": (int, "optimiser steps"),
    "batch": (int, "prompts (dpo: pairs) per step"),
    "group": (int, "continuations of each prompt"),
    "past": (int, "chunks of true motion before a continuation"),
    "own-past": (int, "chunks of that past which the policy makes itself"),
    "length": (int, "chunks in a continuation"),
    "learning-rate": (float, "learning rate of AdamW"),
    "critic-rate": (float, "learning rate of the value head (ppo)"),
    "fewest-events": (int, "events that a prompt's audio must contain"),
    "accumulation": (int, "pieces that a batch is split into, to save memory"),
    "epochs": (int, "steps on the same continuations"),
    "kl-weight": (float, "weight of the divergence from the reference"),
    "kl-stop": (float, "mean KL (nats a code) at which the run stops"),
    "layers": (int, "RVQ layers, coarsest first, that rewards are credited to; 0: all (grpo, ppo)"),
    "discount": (float, "discount of the reward per motion token, for credit by time"),
    "probe": (int, "held-out prompts that progress is measured on"),
    "evaluate-every": (int, "steps between measurements; 0: none"),
    "save-every": (int, "steps between checkpoints"),
    "videos": (int, "held-out prompts rendered at each checkpoint; 0: none"),
    "seed": (int, "seed of prompts and sampled codes"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    parser.epilog = EXAMPLES
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
    beside = kinds.add_parser("compare", help="compare generators on held-out prompts")
    _add_common(beside)
    align_compare.add_arguments(beside)
    align_soup.add_arguments(kinds.add_parser("soup", help="mix generators that were tuned from the same one"))
    targets = kinds.add_parser(
        "targets",
        help="GRPO until a generator keeps time, moves enough and passes for a person",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    align_targets.add_arguments(targets)
    align_rewards.add_arguments(kinds)
    for child in (grpo, dpo, ppo):
        _add_common(child)
        child.add_argument("-o", "--output", type=Path, required=True, help="folder to train in, or to resume")
        child.add_argument("--recipe", choices=RECIPES, default="rehearsal", help="(default: %(default)s)")
        for name, (kind, text) in SETTINGS.items():
            child.add_argument(f"--{name}", type=kind, help=f"{text} (default: the recipe's)")
        child.add_argument("--events", choices=("any", "beat", "stress"), help="(default: the recipe's)")
        child.add_argument("--credit", choices=("sequence", "to_go"), help="(default: the recipe's)")
        child.add_argument(
            "--autocast", action="store_true", help="multiply in bfloat16 on processors that are fast at it"
        )
        child.add_argument(
            "--track",
            action="append",
            default=[],
            choices=("tensorboard", "wandb"),
            help="log metrics there as well as in metrics.jsonl; may be given twice",
        )
        child.add_argument("--minutes", type=float, help="stop this call after so many minutes; call again to resume")


def _add_rollouts(child: argparse.ArgumentParser) -> None:
    _add_common(child)
    child.add_argument("-o", "--output", type=Path, required=True, metavar="JSONL", help="file to write")
    child.add_argument("--prompts", type=int, default=200, help="number of prompts (default: %(default)s)")
    child.add_argument("--recipe", choices=RECIPES, default="rehearsal", help="of the sizes (default: %(default)s)")
    for name in ("group", "past", "length", "fewest-events"):
        kind, text = SETTINGS[name]
        child.add_argument(f"--{name}", type=kind, help=f"{text} (default: the recipe's; group: 8)")
    child.add_argument(
        "--margin", type=float, default=0.5, help="least difference of rewards in a pair (default: %(default)s)"
    )
    child.add_argument("--seed", type=int, default=0, help="seed of prompts and codes (default: %(default)s)")


def _add_common(child: argparse.ArgumentParser) -> None:
    child.add_argument("source", type=Path, metavar="TOKENS", help="folder of codes (`train tokens`)")
    child.add_argument("--model", default="default", help="bundle to tune (default: %(default)s)")
    child.add_argument("--generator", type=Path, help="trained generator instead of the bundle's")
    child.add_argument("--reference", type=Path, help="generator to stay near (default: the one tuned)")
    child.add_argument(
        "--reward",
        action="append",
        metavar="NAME=WEIGHT",
        help="a component of the reward, also MODULE:FUNCTION=WEIGHT; may be repeated (default: beats=1 stresses=1 "
        "liveliness=0.3 smoothness=0.1 planted_feet=0.1 stillness=0.5; with --recipe paper quality=1 alignment=1)",
    )
    child.add_argument(
        "--reference-statistics", type=Path, help="reference statistics of true motion (default: measured now)"
    )
    child.add_argument("--quality", type=Path, help="trained quality reward, for --reward quality=1")
    child.add_argument("--alignment", type=Path, help="trained alignment reward, for --reward alignment=1")
    child.add_argument("--realism", type=Path, metavar="JSON", help="fitted realism reward, for --reward realism=0.04")
    words = {"temperature": "sampling temperature", "cooling": "cooling by RVQ layer", "top-p": "nucleus"}
    for name, text in words.items():
        child.add_argument(f"--{name}", type=float, help=f"{text} to tune for; saved (default: the generator's)")
    child.add_argument("--device", default="cpu", help="(default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Run one of the sub-commands."""
    if args.kind in align_rewards.KINDS:
        return align_rewards.run(args)
    if args.kind == "soup":
        return align_soup.run(args)
    if args.kind == "targets":
        code: int = align_targets.run(args)
        return code
    if args.kind == "compare":
        return align_compare.run(args, _setup(args))
    is_first = os.environ.get("RANK", "0") == "0"
    with tqdm(unit="step", smoothing=0.05, disable=not is_first) as bar:
        ready = _setup(args)

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        if args.kind == "rollouts":
            told = f"{_rollouts(args, ready, progress)} pairs in {args.output}"
        else:
            told = _train(args, ready, progress)
    if is_first:
        print(told)
    return 0


def _setup(args: argparse.Namespace) -> "AlignmentSetup":
    from echoavatar_lab.align.start import load_setup

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
        quality=args.quality,
        alignment=args.alignment,
        realism=args.realism,
        sampling={key: getattr(args, key) for key in ("temperature", "cooling", "top_p")},
        is_compared=args.kind == "dpo",
    )


def _rollouts(args: argparse.Namespace, ready: "AlignmentSetup", progress: Callable[[int, int], None]) -> int:
    from echoavatar_lab.align.config import recipe
    from echoavatar_lab.align.start import make_pairs

    base = recipe(args.recipe, "dpo")
    sizes = {"past": base.past, "length": base.length, "group": CANDIDATES, "fewest_events": base.fewest_events}
    sizes |= {name: getattr(args, name) for name in sizes if getattr(args, name) is not None}
    rest = {name: getattr(args, name) for name in ("prompts", "margin", "seed")}
    return make_pairs(ready, args.output, **rest, **sizes, progress=progress)


def _draw(folder: Path) -> None:
    from echoavatar_lab.align.plots import draw_run

    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return  # curves need the extra `evaluate`; the numbers are in metrics.jsonl
    draw_run(folder / "metrics.jsonl", folder / "metrics.png")


def _train(args: argparse.Namespace, ready: "AlignmentSetup", progress: Callable[[int, int], None]) -> str:
    from echoavatar_lab.align.start import training_task, tune

    training = _training(args)
    names = ("pairs", "margin") if args.kind == "dpo" else ("rollouts",)
    given = {name: getattr(args, name) for name in names}
    stage = training_task(args.kind, training, ready, command=align_rewards.command_line(args), **given)
    how = {"device": args.device, "minutes": args.minutes, "trackers": args.track, "progress": progress}
    stopped = tune(stage, args.output, **how)
    _draw(args.output)
    return (
        f"stopped: {stopped}; {args.output} holds the last checkpoint before"
        if stopped
        else f"{args.kind} in {args.output}"
    )


def _training(args: argparse.Namespace) -> "AlignTraining":
    from echoavatar_lab.align.config import AlignTraining, recipe

    base = recipe(args.recipe, args.kind)
    names = [*(name.replace("-", "_") for name in SETTINGS), "credit", "events"]
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    given |= {"autocast": args.autocast}
    return AlignTraining.model_validate(base.model_dump() | given)
