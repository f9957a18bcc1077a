"""`echoavatar align calibrate`, `reward-quality`, `reward-alignment`, `reward-realism`: learned rewards, then JSON."""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any, get_args

from echoavatar.cli.options import seed
from echoavatar.engine.pipeline import Bundle, load_bundle
from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab import paper
from echoavatar_lab.align.audio_encoders import KINDS as ENCODERS
from echoavatar_lab.align.audio_reward import AudioMotionConfig
from echoavatar_lab.align.audio_reward_train import (
    AudioMotionWindows,
    AudioRewardTask,
    AudioRewardTraining,
    decoded_features,
    decoded_waveforms,
    retrieval_tables,
    untrained,
)
from echoavatar_lab.align.corruption import paper_scores, read_scores, scores_from_fid
from echoavatar_lab.align.policy import GeneratorPolicy
from echoavatar_lab.align.prompts import Events, PromptSampler, read_token_clips, train_and_test
from echoavatar_lab.align.quality import (
    CorruptedWindows,
    QualityConfig,
    QualityTask,
    QualityTraining,
    calibrate,
    draw_quality,
    measure_quality,
)
from echoavatar_lab.align.realism import fit_realism
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.evaluation.people import read_people
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.progress import Progress, progress_bar
from echoavatar_lab.training import train

from .config_options import add_fields, command_line, given_fields

PAPER_WORDS = (
    "width 512, 8 heads, 20,000 steps; quality: dual-path resampling, no differences; alignment: the whole clip, rate"
    " 1e-4, batch 32, motion features, BEATs if --encoder-weights are given"
)
QUALITY_SIZES = ("width", "heads")
ALIGNMENT_SIZES = ("width", "heads", "layers", "slices")
RUN = ("seed", "minutes", "autocast")


def add_arguments(kinds: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the sub-commands."""
    calibrate = kinds.add_parser("calibrate", help="FID of every corruption level, and scores from it")
    quality = kinds.add_parser("reward-quality", help="train the motion quality reward")
    alignment = kinds.add_parser("reward-alignment", help="train the audio-motion alignment reward")
    realism = kinds.add_parser("reward-realism", help="fit the realism reward to a generator and captured people")
    for child in (calibrate, quality, alignment, realism):
        child.add_argument("source", type=Path, metavar="TOKENS", help="folder of codes (`train tokens`)")
        child.add_argument("-o", "--output", type=Path, required=True, help="folder (calibrate, reward-realism: file)")
        child.add_argument("--model", default="default", help="bundle with codec and tokenizer (default: %(default)s)")
        child.add_argument("--seed", type=seed, default=0, help="(default: %(default)s)")
    calibrate.add_argument("--windows", type=int, default=64, help="windows per level (default: %(default)s)")
    quality.add_argument("--scores", type=Path, help="scores from `align calibrate` (default: the paper's table)")
    quality.add_argument("--windows", type=int, default=32, help="held-out windows per level (default: %(default)s)")
    add_fields(quality, QualityTraining, ("steps",))
    add_fields(quality, QualityConfig, QUALITY_SIZES)
    alignment.add_argument(
        "--encoder",
        choices=ENCODERS,
        default="codes",
        help="audio encoder: the codec's codes, or BEATs (paper) or Wav2CLIP (its comparison) on audio that the codec "
        "decodes (default: %(default)s)",
    )
    alignment.add_argument(
        "--encoder-weights",
        type=Path,
        metavar="FILE",
        help="published weights, such as BEATs_iter3_plus_AS2M.pt or Wav2CLIP's ResNet_CX.ckpt, which are kept fixed "
        "(default: a small network of that kind, trained with the reward)",
    )
    add_fields(alignment, AudioMotionConfig, ("motion", *ALIGNMENT_SIZES))
    add_fields(alignment, AudioRewardTraining, ("steps", "batch"))
    alignment.add_argument("--rate", type=float, help="peak learning rate (default: 1e-3; paper: 1e-4)")
    for child in (quality, alignment):
        child.add_argument(
            "--paper", action="store_true", help=f"the paper's choices; in place of the defaults: {PAPER_WORDS}"
        )
        child.add_argument(
            "--autocast", action="store_true", help="multiply in bfloat16 on processors that are fast at it"
        )
        child.add_argument("--minutes", type=float, default=0.0, help="training time, the schedule fitted to it")
    realism.add_argument("--captured", type=Path, required=True, help="captured clips, as for `evaluate BUNDLE alive`")
    realism.add_argument("--generator", type=Path, help="trained generator instead of the bundle's")
    realism.add_argument("--past", type=int, default=22, help="as in `align grpo` (default: %(default)s)")
    realism.add_argument("--own-past", type=int, default=15, help="likewise (default: %(default)s)")
    realism.add_argument("--length", type=int, default=20, help="likewise: the window judged (default: %(default)s)")
    realism.add_argument("--prompts", type=int, default=96, help="prompts to continue (default: %(default)s)")
    realism.add_argument("--group", type=int, default=4, help="continuations of each (default: %(default)s)")
    realism.add_argument("--events", choices=get_args(Events), default="any", help="(default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Run one of the sub-commands."""
    bundle = load_bundle(args.model)
    clips = read_token_clips(args.source, bundle.generator.config.layout, needs_truth=args.kind != "reward-realism")
    taught, asked = train_and_test(clips, args.source)
    if not asked and args.kind in ("reward-quality", "reward-alignment"):
        raise EchoAvatarError(f"{args.source} holds no clip of split test, on which {args.kind} is measured")
    with progress_bar() as say:
        found = KINDS[args.kind](args, bundle, taught, asked, partial(say, args.kind))
    print(json.dumps(found))
    return 0


def chosen(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """The settings that the user gave; with --paper, the paper's values for the others."""
    found = {"reward-quality": paper.QUALITY, "reward-alignment": paper.ALIGNMENT}[args.kind] if args.paper else {}
    both = {name: value for section in found.values() for name, value in section.items()}
    return {name: both[name] for name in names if name in both} | given_fields(args, names)


Clips = dict[str, TokenClip]


def _calibrate(
    args: argparse.Namespace, bundle: Bundle, taught: Clips, asked: Clips, progress: Progress
) -> dict[str, Any]:
    levels = CorruptedWindows(bundle.tokenizer, list(taught.values()), seed=args.seed)
    fid = calibrate(levels, load_shipped(), windows=args.windows)
    found = {"fid": fid, "scores": scores_from_fid(fid)}
    make_output_folder(args.output.parent)
    write_whole(args.output, json.dumps(found, indent=1) + "\n")
    return found


def _quality(
    args: argparse.Namespace, bundle: Bundle, taught: Clips, asked: Clips, progress: Progress
) -> dict[str, Any]:
    scores = read_scores(args.scores) if args.scores else paper_scores()
    channels = bundle.tokenizer.mean.numel()
    model = train(
        QualityTask(
            CorruptedWindows(bundle.tokenizer, list(taught.values()), seed=args.seed),
            QualityConfig.model_validate(chosen(args, *QualityConfig.model_fields) | {"features": channels}),
            QualityTraining.model_validate(chosen(args, "steps", *RUN)),
            scores=scores,
            card=_card(args),
        ),
        args.output,
        progress=progress,
    ).model
    held_out = CorruptedWindows(bundle.tokenizer, list(asked.values()), seed=args.seed + 1)
    found = measure_quality(model, held_out, scores, windows=args.windows)
    write_whole(args.output / "held_out.json", json.dumps(found, indent=1) + "\n")
    draw_quality(found, scores, args.output / "held_out.png")
    return found


def _alignment(
    args: argparse.Namespace, bundle: Bundle, taught: Clips, asked: Clips, progress: Progress
) -> dict[str, Any]:
    encoder = "beats" if args.paper and args.encoder_weights and args.encoder == "codes" else args.encoder
    if args.encoder_weights and encoder == "codes":
        raise EchoAvatarError("--encoder-weights need --encoder beats or wav2clip; name one of them")
    sizes = chosen(args, "motion", "size", *ALIGNMENT_SIZES)
    model = untrained(
        bundle.codec, bundle.tokenizer, encoder=encoder, weights=args.encoder_weights, seed=args.seed, **sizes
    )

    def pairs(clips: Clips) -> AudioMotionWindows:
        waves = None if encoder == "codes" else decoded_waveforms(bundle.codec, clips, progress)
        is_read = model.config.motion == "features"
        features = decoded_features(bundle.tokenizer, clips, progress) if is_read else None
        return AudioMotionWindows(clips, waves=waves, features=features)

    rate = {"learning_rate": args.rate} if args.rate else {}
    training = AudioRewardTraining.model_validate(
        chosen(args, "steps", "batch", "learning_rate", "schedule", *RUN) | rate
    )
    model = train(
        AudioRewardTask(model, pairs(taught), training, card=_card(args)), args.output, progress=progress
    ).model
    found = retrieval_tables(model, pairs(asked))
    write_whole(args.output / "held_out.json", json.dumps(found, indent=1) + "\n")
    return found


def _realism(
    args: argparse.Namespace, bundle: Bundle, taught: Clips, asked: Clips, progress: Progress
) -> dict[str, Any]:
    if args.own_past > args.past:
        raise EchoAvatarError(f"--own-past ({args.own_past}) chunks are the last of --past ({args.past}): lower it")
    generator = Generator.load(args.generator) if args.generator else bundle.generator
    book = PromptSampler(
        taught,
        past=args.past - args.own_past,
        length=args.own_past + args.length,
        seed=args.seed,
        fewest_events=0 if args.events == "any" else 2,
        events=args.events,
    )
    reward, found = fit_realism(
        GeneratorPolicy(generator),
        bundle.tokenizer,
        book,
        read_people(args.captured, for_training=True),
        length=args.length,
        prompts=args.prompts,
        group=args.group,
        seed=args.seed,
        progress=progress,
    )
    reward.save(args.output)
    return dict(found)


KINDS = {
    "calibrate": _calibrate,
    "reward-quality": _quality,
    "reward-alignment": _alignment,
    "reward-realism": _realism,
}


def _card(args: argparse.Namespace) -> dict[str, object]:
    return {"data": str(args.source), "command": command_line(args), "licence": "as its data"}
