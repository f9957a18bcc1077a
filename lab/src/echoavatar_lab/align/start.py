"""Builds a training task from folders: bundle, token files, reference statistics, rewards."""

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from echoavatar.engine.pipeline import Bundle, load_bundle
from echoavatar.errors import CheckpointError, EchoAvatarError, MotionError
from echoavatar.stored import read_card
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.progress import Progress
from echoavatar_lab.training import has_state, train
from echoavatar_lab.training.metrics_log import FILE, append_metrics, read_metrics

from .audio_reward import AudioMotion
from .decoded_motion import decode_truth
from .dpo import DpoTask, PreferencePair, rank_pairs, read_pairs, write_pairs
from .policy import GeneratorPolicy, continuations
from .probe import DecodingJudge, MotionMetrics, Probe, SampleVideos
from .prompts import PromptSampler, read_token_clips, train_and_test
from .quality import QualityReward
from .realism import Realism
from .rewards import ReferenceStatistics, RewardMix, imported, measure_reference_statistics, parse_weights
from .rollouts import GrpoTask, PpoTask
from .trainer import AlignTraining, DivergedError, Method, PolicyTask, RunContext

DEFAULT_REWARDS = ("beats=1", "stresses=1", "liveliness=0.3", "smoothness=0.1", "planted_feet=0.1", "stillness=0.5")
STATISTICS_PROMPTS = 160
STATISTICS_PAST, STATISTICS_LENGTH = 3, 9


@dataclass(frozen=True)
class AlignmentSetup:
    """Models, clips and rewards, which all methods need."""

    tokenizer: BodyTokenizer
    generator: Generator
    reference: Generator
    reference_name: str
    train: dict[str, TokenClip]
    test: dict[str, TokenClip]
    mix: RewardMix
    card: dict[str, object]
    codec: AudioCodec | None = None  # gives the videos sound


def load_setup(
    tokens: Path,
    folder: Path,
    *,
    bundle: str | Path = "default",
    generator: Path | None = None,
    reference: Path | None = None,
    rewards: Sequence[str] | None = None,
    reference_statistics: Path | None = None,
    earlier: int = 0,
    sampling: Mapping[str, float] | None = None,
    quality: Path | None = None,
    alignment: Path | None = None,
    realism: Path | None = None,
    is_compared: bool = False,
) -> AlignmentSetup:
    """Load models, clips and rewards.

    Reference statistics that are not given are measured on the train clips and kept in `folder`.
    `earlier` is how many frames before the truth's strokes on stresses should come.
    With `is_compared` (DPO) rewards only measure progress on held-out clips. If there is neither true motion nor a file
    of reference statistics, as for a studio's token files, nothing is measured.

    Raises:
        CheckpointError: a checkpoint is missing or damaged.
        MotionError: the token files are missing or of another vocabulary.
        EchoAvatarError: a reward is unknown, or learned and not given.
    """
    parts, policy, kept_near, card = load_policy(tokens, bundle, generator, sampling or {})
    if reference:
        kept_near = Generator.load(reference)
    train, test = train_and_test(read_token_clips(tokens, policy.config.layout), tokens)
    has_statistics = reference_statistics is not None or (folder / "reference_statistics.json").exists()
    is_unmeasured = is_compared and not rewards and not has_statistics and not any(c.has_truth for c in train.values())
    weights = {} if is_unmeasured else parse_weights(rewards or DEFAULT_REWARDS)
    learned: dict[str, tuple[Path | None, Any]] = {
        "quality": (quality, QualityReward),
        "alignment": (alignment, AudioMotion),
        "realism": (realism, Realism),
    }
    for name, (file, _) in learned.items():
        if name in weights and not file:
            raise EchoAvatarError(f"the reward {name} is learned first: pass --{name} (docs/alignment.md)")
    own = {name: kind.load(file).judge for name, (file, kind) in learned.items() if file}
    rule = None if is_unmeasured else load_or_measure(parts.tokenizer, train, reference_statistics, folder)
    mix = RewardMix(weights, rule and rule.earlier(earlier), own)
    name = str(reference or generator or bundle)
    card |= {"rewards": weights}
    return AlignmentSetup(parts.tokenizer, policy, kept_near, name, train, test, mix, card, parts.codec)


def load_policy(
    tokens: Path, bundle: str | Path, generator: Path | None, sampling: Mapping[str, float]
) -> tuple[Bundle, Generator, Generator, dict[str, object]]:
    """The bundle, the generator to tune with its sampling settings, a copy of it to stay near, and its card."""
    parts = load_bundle(bundle)
    policy = Generator.load(generator) if generator else parts.generator
    policy.config = policy.config.model_copy(update=dict(sampling))
    kept_near = Generator(policy.config)
    kept_near.load_state_dict(policy.state_dict())
    begun = read_card(generator) if generator else parts.card
    card: dict[str, object] = {"data": str(tokens), "licence": begun.get("licence", "Apache-2.0")}
    return parts, policy, kept_near, card | {"begun_from": str(generator or bundle)}


def load_or_measure(
    tokenizer: BodyTokenizer, clips: Mapping[str, TokenClip], given: Path | None, folder: Path
) -> ReferenceStatistics:
    """The reference statistics in `given` or in `folder`, or measured on evenly chosen true motion and saved there."""
    kept = folder / "reference_statistics.json"
    if given or kept.exists():
        return ReferenceStatistics.load(given or kept)
    clips = {name: clip for name, clip in clips.items() if clip.has_truth}
    if not clips:
        raise MotionError(
            "rewards are measured against true motion, and these token files hold only motion that a generator made;"
            " pass the --reference-statistics that a run on a folder of `echoavatar train tokens` has left"
        )
    book = PromptSampler(clips, past=STATISTICS_PAST, length=STATISTICS_LENGTH)
    found = measure_reference_statistics(decode_truth(tokenizer, book.spread(STATISTICS_PROMPTS)))
    found.save(kept)
    return found


def training_task(
    method: Method,
    training: AlignTraining,
    ready: AlignmentSetup,
    *,
    pairs: Path | None = None,
    margin: float = 0.0,
    rollouts: str | None = None,
    command: str = "",
) -> PolicyTask[Any]:
    """A training task of the method; `rollouts` names a backend as module:function (docs/alignment.md)."""

    def book(clips: Mapping[str, TokenClip]) -> PromptSampler:
        return PromptSampler(
            clips,
            past=training.past,
            length=training.length,
            seed=training.seed,
            fewest_events=training.fewest_events,
            events=training.events,
        )

    judge = DecodingJudge(ready.tokenizer, ready.mix)
    probe = sample_writer = None
    if ready.test and ready.mix.weights:
        asked = book(ready.test).spread(training.probe)
        statistics, metrics = ready.mix.reference_statistics, None
        if statistics is not None and all(ready.test[prompt.clip].has_truth for prompt in asked):
            metrics = MotionMetrics(ready.tokenizer, asked, load_shipped(), statistics)
        probe = Probe(asked, judge, group=training.probe_group, motion_metrics=metrics)
        if training.videos and ready.codec is not None:
            sample_writer = SampleVideos(ready.codec, ready.tokenizer, asked[: training.videos])
    context = RunContext(
        card=ready.card | {"command": command},
        probe=probe,
        sample_writer=sample_writer,
        rewards=ready.mix.weights,
        reference_name=ready.reference_name,
        rollouts=imported(rollouts, "backend") if rollouts else None,
    )
    parts = (ready.generator, ready.reference, training, judge, context)
    match method:
        case "grpo":
            return GrpoTask(*parts, book=book(ready.train))
        case "ppo":
            return PpoTask(*parts, book=book(ready.train))
        case "dpo":
            if pairs is None:
                raise MotionError("dpo needs preference pairs: pass --pairs, made by `echoavatar align rollouts`")
            everything = PromptSampler(ready.train | ready.test, past=training.past, length=training.length)
            compared = read_pairs(pairs, everything, ready.generator.config.layout, margin=margin)
            return DpoTask(*parts, pairs=compared)


def tune(
    task: PolicyTask[Any],
    folder: Path,
    *,
    device: str = "cpu",
    minutes: float | None = None,
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> str:
    """Train into `folder`, or resume the run in it; returns why the run ended early, or an empty string.

    A run that diverges ends with its last checkpoint from before; calling again would repeat the same steps and end in
    the same place. Raises CheckpointError: the run diverged before its first checkpoint, or the folder holds another
    run.
    """
    is_first = os.environ.get("RANK", "0") == "0"  # the process that writes
    with hold_folder(folder) if is_first else nullcontext():
        return _tune(
            task, folder, is_first=is_first, device=device, minutes=minutes, trackers=trackers, progress=progress
        )


def _tune(task: PolicyTask[Any], folder: Path, *, is_first: bool, device: str, **how: Any) -> str:
    is_measured = is_first and task.context.probe is not None and task.config.evaluate_every > 0
    if is_measured and not has_state(folder):
        (folder / FILE).unlink(missing_ok=True)
        for generator in (task.generator, task.reference.generator):
            generator.to(device)
        append_metrics(folder, 0, task.evaluate())
    try:
        train(task, folder, device=device, **how)
    except DivergedError as error:
        if not has_state(folder):
            raise CheckpointError(
                f"{error}, before the first checkpoint; use a smaller learning rate or a larger kl_weight"
            ) from error
        if is_first:
            append_metrics(folder, _step(folder), {"stopped": str(error)})
        return str(error)
    if is_measured and _step(folder) == task.config.steps and not _is_told(folder, task.config.steps):
        append_metrics(folder, task.config.steps, task.evaluate())
    return ""


def _step(folder: Path) -> int:
    return int(str(read_card(folder)["step"]))


def _is_told(folder: Path, step: int) -> bool:
    return any(line["step"] == step and "held_out" in line for line in read_metrics(folder / FILE))


def make_pairs(
    ready: AlignmentSetup,
    path: Path,
    training: AlignTraining,
    *,
    prompts: int,
    margin: float = 0.0,
    progress: Progress | None = None,
) -> int:
    """Write best and worst continuation by reward of prompts from the train clips as a file of pairs.

    Sizes and seed are those of `training`.
    """
    past, seed = training.past, training.seed
    book = PromptSampler(
        ready.train, past=past, length=training.length, seed=seed, fewest_events=training.fewest_events
    )
    policy, judge = GeneratorPolicy(ready.generator), DecodingJudge(ready.tokenizer, ready.mix)
    pairs, how = list[PreferencePair](), {"group": training.group, "seed": seed}
    for drawn, codes in continuations(policy, book, prompts=prompts, **how, progress=progress):
        pairs += rank_pairs(drawn, codes, judge, past=past, margin=margin)
    return write_pairs(path, pairs)
