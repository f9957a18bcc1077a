"""The paper's alignment-fidelity trade-off: the same generator untuned, and tuned by DPO, GRPO and PPO.

Both learned rewards are trained on the corpus first. Each method then tunes the generator of the main table's last
line by the sum of the rewards, as in the paper. The paper's DPO learns from people; ours learns from pairs ranked by
the same rewards. Rewards are measured on held-out prompts, the same for all lines; everything else on the test clips,
through the live pipeline.
"""

import copy
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from echoavatar.models.generator import Generator
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.align.audio_reward_train import (
    WINDOW_CHUNKS,
    AudioMotionWindows,
    AudioRewardTraining,
    train_audio_reward,
)
from echoavatar_lab.align.config import AlignTraining, Method, recipe
from echoavatar_lab.align.prompts import read_token_clips
from echoavatar_lab.align.quality import QualityConfig, QualityReward
from echoavatar_lab.align.quality_train import CorruptedWindows, QualityTraining, train_quality
from echoavatar_lab.align.reference_statistics import ReferenceStatistics
from echoavatar_lab.align.rewards import RewardMix
from echoavatar_lab.align.start import AlignmentSetup, make_pairs, training_task, tune
from echoavatar_lab.align.trainer import fingerprint
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.tables.scale import ScaleName

from .choices import OURS, GeneratorChoice
from .experiment import Experiment, motion_of
from .make_once import make_once
from .scores import GENERATION, generation_scores
from .table import Cell, Column, Line, Table, cells
from .waves import Part, generator_waves

NAME = "alignment"
REWARDS = ("quality", "alignment")
NORMAL = 1.96  # standard errors of a 95 % interval
COLUMNS = (
    Column("fid", "FID"),
    Column("diversity", "Diversity", better="higher"),
    Column("ba_g", "BA_G", "1/10", better="higher"),
    Column("ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("ba_d", "BA_D", "1/10", better="higher"),
    Column("ba_d_over", "BA_D over chance", "1/10", better="higher"),
    Column("quality", "Quality reward", better="higher"),
    Column("alignment", "Alignment reward", better="higher"),
    Column("kl", "KL", "nats a code"),
)
UNTUNED = ("Ours (no RL)", (9.465, 20.70, 8.277, 2.603))
LINES: dict[Method, tuple[str, tuple[float, ...]]] = {
    "dpo": ("Ours (DPO)", (12.39, 19.67, 8.283, 2.607)),
    "grpo": ("Ours (GRPO)", (24.13, 20.89, 8.239, 2.618)),
    "ppo": ("Ours (PPO)", (24.97,)),
}
NO_STATISTICS = ReferenceStatistics(
    beat=(0.0,), stress=(0.0,), speed=(0.0,) * 3, movement=((0.0,) * 4,) * 3, jerk=1.0, scenes=1
)
"""Learned rewards need no reference statistics."""


class Budget(NamedTuple):
    """Training steps and width of the reward models, and the number of prompts for DPO's pairs."""

    quality_steps: int
    alignment_steps: int
    width: int
    prompts: int


BUDGETS: dict[ScaleName, Budget] = {
    "tiny": Budget(4, 4, 32, 4),
    "rehearsal": Budget(1200, 1000, 96, 200),
    "paper": Budget(20_000, 20_000, 512, 2_000),
}


class Outcome(NamedTuple):
    """A tuned generator's motion for the test clips, and its rewards."""

    motions: list[Motion]
    rewards: dict[str, Cell]


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`: the generator, both rewards, the three methods."""
    return [*generator_waves([GeneratorChoice(OURS.name)]), [_setting], [partial(tuned, method=one) for one in LINES]]


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    keys = ("fid", "diversity", "ba_g", "ba_d")
    truth = [motion_of(clip) for clip in experiment.test_clips]
    lines = [Line("GT", {}, _scored(experiment, truth))]
    experiment.say(f"line: {UNTUNED[0]}")
    untuned = _scored(experiment, experiment.generated_motions(GeneratorChoice(OURS.name)))
    lines.append(Line(UNTUNED[0], dict(zip(keys, UNTUNED[1], strict=True)), untuned))
    for method, (name, paper) in LINES.items():
        experiment.say(f"line: {name}")
        found = tuned(experiment, method)
        scores = _scored(experiment, found.motions) | found.rewards
        lines.append(Line(name, dict(zip(keys, paper, strict=False)), scores))
    lines[1] = replace(lines[1], ours=untuned | rewards_of(_folder(experiment, "grpo"), is_first=True))
    notes = (
        "Rewards: cosine of sound and motion, and motion quality, both learned, summed with equal weights; on "
        "held-out prompts. In brackets: 95 % intervals over prompts.",
        "The paper's DPO learns from people, ours from continuations ranked by the same rewards.",
        f"Tuned for {_training(experiment, 'grpo').steps} steps with the recipe of the scale.",
    )
    return Table(NAME, "Alignment against fidelity (paper, RL Strategy Analysis and PPO)", COLUMNS, lines, notes)


def tuned(experiment: Experiment, method: Method) -> Outcome:
    """Tune the generator of the main table's last line by a method and generate motion for the test clips."""
    folder, training = _folder(experiment, method), _training(experiment, method)
    ready = _setting(experiment)
    settings = {
        "generator": fingerprint(ready.generator),
        "training": training.model_dump(mode="json"),
        "effort": BUDGETS[experiment.scale.name]._asdict(),
        "codes": experiment.codes_settings(OURS),
    }

    def work() -> None:
        pairs = None
        if method == "dpo":
            pairs = folder / "pairs.jsonl"
            if not pairs.exists():
                _rank(experiment, ready, pairs, training)
        stage = training_task(method, training, ready, pairs=pairs, command="echoavatar reproduce alignment")
        tune(stage, folder, device=experiment.device, trackers=experiment.trackers, progress=experiment.progress)

    make_once(folder, settings, work)
    motions = folder / "made" / experiment.runtime
    make_once(
        motions,
        settings | {"runtime": experiment.runtime, "clips": [clip.name for clip in experiment.test_clips]},
        lambda: experiment.write_motions(motions, experiment.tokenizer(OURS), Generator.load(folder)),
    )
    return Outcome(experiment.written_motions(motions), rewards_of(folder))


def rewards_of(folder: Path, *, is_first: bool = False) -> dict[str, Cell]:
    """Both rewards and the KL divergence on held-out prompts, from the last measurement of a run or from the first."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    probe = [line["held_out"] for line in lines if "held_out" in line][0 if is_first else -1]
    found = {name: probe["rewards"][name] for name in REWARDS}
    made = {name: Cell(mean, mean - NORMAL * error, mean + NORMAL * error) for name, (mean, error) in found.items()}
    return made | {"kl": Cell(probe["kl"])}


def _training(experiment: Experiment, method: Method) -> AlignTraining:
    """The recipe of the scale, with the experiment's seed."""
    return recipe(experiment.scale.name, method).model_copy(update={"seed": experiment.seed})


def _setting(experiment: Experiment) -> AlignmentSetup:
    choice = GeneratorChoice(OURS.name)
    generator = experiment.generator(choice)
    train_clips, test_clips = token_clips(experiment)
    own = {
        "quality": _quality(experiment, train_clips).judge,
        "alignment": alignment_reward(experiment, train_clips).judge,
    }
    mix = RewardMix(dict.fromkeys(REWARDS, 1.0), NO_STATISTICS, own)
    card: dict[str, object] = {"data": experiment.corpus.folder.name, "begun_from": OURS.name}
    return AlignmentSetup(
        experiment.tokenizer(OURS), generator, copy.deepcopy(generator), "no RL", train_clips, test_clips, mix, card
    )


def token_clips(experiment: Experiment) -> tuple[dict[str, TokenClip], dict[str, TokenClip]]:
    """Codes of the training clips and of the other clips, by name."""
    experiment.codes(OURS)
    clips = read_token_clips(experiment.folder / "tokens" / OURS.name)
    train_clips = {name: clip for name, clip in clips.items() if clip.split == "train"}
    return train_clips, {name: clip for name, clip in clips.items() if clip.split != "train"}


def _quality(experiment: Experiment, clips: dict[str, TokenClip]) -> QualityReward:
    folder, budget = experiment.folder / "rewards" / "quality", BUDGETS[experiment.scale.name]
    training = QualityTraining(steps=budget.quality_steps, seed=experiment.seed)
    tokenizer = experiment.tokenizer(OURS)
    levels = CorruptedWindows(tokenizer, list(clips.values()), seed=experiment.seed, chunks=reward_window(clips))
    settings = _reward_settings(experiment, training, budget)
    config = QualityConfig(features=tokenizer.mean.numel(), width=budget.width)
    make_once(folder, settings, lambda: train_quality(levels, folder, training, config=config))
    return QualityReward.load(folder)


def alignment_reward(experiment: Experiment, clips: dict[str, TokenClip]) -> AudioMotion:
    """The reward that compares sound and motion, trained or loaded."""
    folder, budget = experiment.folder / "rewards" / "alignment", BUDGETS[experiment.scale.name]
    training = AudioRewardTraining(steps=budget.alignment_steps, seed=experiment.seed)
    books = experiment.codec.codebooks.detach(), experiment.tokenizer(OURS).codebooks().detach()
    pairs = AudioMotionWindows(clips, chunks=reward_window(clips))
    settings = _reward_settings(experiment, training, budget)

    def work() -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(experiment.seed)
            model = AudioMotion.from_codebooks(*books, width=budget.width)
        train_audio_reward(model, pairs, folder, training)

    make_once(folder, settings, work)
    return AudioMotion.load(folder)


def _reward_settings(
    experiment: Experiment, training: QualityTraining | AudioRewardTraining, budget: Budget
) -> dict[str, object]:
    """What a reward depends on; one that was trained on other codes is refused."""
    codes = experiment.codes_settings(OURS)
    return {"training": training.model_dump(mode="json"), "width": budget.width, "codes": codes}


def reward_window(clips: dict[str, TokenClip]) -> int:
    """The window of both rewards in chunks: 4 s, or less if the clips are shorter."""
    return min(WINDOW_CHUNKS, *(clip.chunks for clip in clips.values()))


def _rank(experiment: Experiment, ready: AlignmentSetup, path: Path, training: AlignTraining) -> None:
    make_pairs(
        ready,
        path,
        prompts=BUDGETS[experiment.scale.name].prompts,
        past=training.past,
        length=training.length,
        group=8,
        margin=0.0,
        fewest_events=training.fewest_events,
        seed=experiment.seed,
        progress=experiment.progress,
    )


def _folder(experiment: Experiment, method: Method) -> Path:
    return experiment.folder / "alignment" / method


def _scored(experiment: Experiment, motions: list[Motion]) -> dict[str, Cell]:
    return cells(
        generation_scores(motions, experiment.test_clips, experiment.extractor, seed=experiment.seed), GENERATION
    )
