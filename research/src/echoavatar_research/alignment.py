"""Table of the paper's alignment-fidelity trade-off: the same generator untuned and tuned by DPO, GRPO and PPO.

Both learned rewards are trained on the corpus first, then each method tunes the generator of the main table's last line
by their sum, as in the paper. The paper's DPO learns from people; ours from pairs ranked by the same rewards. Rewards
are of held-out prompts, the same for all lines; everything else is of the test clips, through the live pipeline.
"""

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from echoavatar.align.audio_reward import AudioMotion
from echoavatar.align.audio_reward_train import WINDOW_CHUNKS, AudioRewardTraining, Pairs, train_audio_reward
from echoavatar.align.config import AlignTraining, Method, recipe
from echoavatar.align.prompts import read_token_clips
from echoavatar.align.quality import QualityConfig, QualityReward
from echoavatar.align.quality_train import Levels, QualityTraining, train_quality
from echoavatar.align.rewards import RewardMix
from echoavatar.align.start import Setting, make_pairs, stage_of, tune
from echoavatar.align.trainer import fingerprint
from echoavatar.align.yardstick import Yardstick
from echoavatar.data import Clip
from echoavatar.evaluation.scale import ScaleName
from echoavatar.generator import Generator, TokenClip
from echoavatar.kinematics import Motion

from .choices import OURS, GeneratorChoice
from .kept import kept
from .scores import GENERATION, generated
from .table import Cell, Column, Line, Table, cells
from .workshop import TOGETHER, Workshop, motion_of

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
NO_YARDSTICK = Yardstick(beat=(0.0,), stress=(0.0,), speed=(0.0, 0.0, 0.0), jerk=1.0, scenes=1)
"""Learned rewards know what is good by themselves."""


class Effort(NamedTuple):
    """How long rewards are trained, and from how many prompts DPO's pairs come."""

    quality_steps: int
    alignment_steps: int
    width: int
    prompts: int


EFFORTS: dict[ScaleName, Effort] = {
    "tiny": Effort(4, 4, 32, 4),
    "rehearsal": Effort(1200, 1000, 96, 200),
    "paper": Effort(20_000, 20_000, 512, 2_000),
}


class Outcome(NamedTuple):
    """What became of a generator."""

    motions: list[Motion]
    rewards: dict[str, Cell]


def make(workshop: Workshop) -> Table:
    """Train what is missing, score, tabulate."""
    keys = ("fid", "diversity", "ba_g", "ba_d")
    truth = [motion_of(clip) for clip in workshop.tests]
    lines = [Line("GT", {}, _scored(workshop, truth))]
    workshop.say(f"line: {UNTUNED[0]}")
    untuned = _scored(workshop, workshop.made(GeneratorChoice(OURS.name)))
    lines.append(Line(UNTUNED[0], dict(zip(keys, UNTUNED[1], strict=True)), untuned))
    for method, (name, paper) in LINES.items():
        workshop.say(f"line: {name}")
        found = tuned(workshop, method)
        scores = _scored(workshop, found.motions) | found.rewards
        lines.append(Line(name, dict(zip(keys, paper, strict=False)), scores))
    lines[1] = replace(lines[1], ours=untuned | rewards_of(_folder(workshop, "grpo"), is_first=True))
    notes = (
        "Rewards: cosine of sound and motion, and motion quality, both learned, summed with equal weights; on "
        "held-out prompts. In brackets: 95 % intervals over prompts.",
        "The paper's DPO learns from people, ours from continuations ranked by the same rewards.",
        f"Tuned for {_training(workshop, 'grpo').steps} steps with the recipe of the scale.",
    )
    return Table(
        NAME, "Alignment against fidelity (paper, RL Strategy Analysis and PPO)", COLUMNS, lines, notes
    )


def tuned(workshop: Workshop, method: Method) -> Outcome:
    """The generator of the main table's last line tuned by a method, and what it makes of the test clips."""
    folder, training = _folder(workshop, method), _training(workshop, method)
    ready = _setting(workshop)
    asked = {
        "generator": fingerprint(ready.generator),
        "training": training.model_dump(mode="json"),
        "effort": EFFORTS[workshop.scale.name]._asdict(),
    }

    def work() -> None:
        pairs = None
        if method == "dpo":
            pairs = folder / "pairs.jsonl"
            if not pairs.exists():
                _rank(workshop, ready, pairs, training)
        stage = stage_of(method, training, ready, pairs=pairs, command="echoavatar reproduce alignment")
        tune(stage, folder, device=workshop.device, progress=workshop.progress)

    kept(folder, asked, work)
    motions = folder / "made"
    kept(motions, asked | {"clips": [clip.name for clip in workshop.tests]}, lambda: _move(workshop, folder))
    return Outcome(
        [motion_of(Clip.load(motions / f"{clip.name}.npz")) for clip in workshop.tests], rewards_of(folder)
    )


def rewards_of(folder: Path, *, is_first: bool = False) -> dict[str, Cell]:
    """Both rewards and the divergence at the last measurement on held-out prompts of a run, or at the first."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    probe = [line["held_out"] for line in lines if "held_out" in line][0 if is_first else -1]
    found = {name: probe["rewards"][name] for name in REWARDS}
    made = {
        name: Cell(mean, mean - NORMAL * error, mean + NORMAL * error)
        for name, (mean, error) in found.items()
    }
    return made | {"kl": Cell(probe["kl"])}


def _training(workshop: Workshop, method: Method) -> AlignTraining:
    """The recipe of the scale."""
    return recipe(workshop.scale.name, method).model_copy(update={"seed": workshop.seed})


def _setting(workshop: Workshop) -> Setting:
    choice = GeneratorChoice(OURS.name)
    generator = workshop.generator(choice)
    train_clips, test_clips = _clips(workshop)
    own = {
        "quality": _quality(workshop, train_clips).judge,
        "alignment": _alignment(workshop, train_clips).judge,
    }
    mix = RewardMix(dict.fromkeys(REWARDS, 1.0), NO_YARDSTICK, own)
    card: dict[str, object] = {"data": workshop.corpus.folder.name, "begun_from": OURS.name}
    return Setting(
        workshop.tokenizer(OURS),
        generator,
        copy.deepcopy(generator),
        "no RL",
        train_clips,
        test_clips,
        mix,
        card,
    )


def _clips(workshop: Workshop) -> tuple[dict[str, TokenClip], dict[str, TokenClip]]:
    """Codes of the train and of the other clips, by name."""
    workshop.codes(OURS)
    clips = read_token_clips(workshop.folder / "tokens" / OURS.name)
    train_clips = {name: clip for name, clip in clips.items() if clip.split == "train"}
    return train_clips, {name: clip for name, clip in clips.items() if clip.split != "train"}


def _quality(workshop: Workshop, clips: dict[str, TokenClip]) -> QualityReward:
    folder, effort = workshop.folder / "rewards" / "quality", EFFORTS[workshop.scale.name]
    training = QualityTraining(steps=effort.quality_steps, seed=workshop.seed)
    tokenizer = workshop.tokenizer(OURS)
    levels = Levels(tokenizer, list(clips.values()), seed=workshop.seed, chunks=_window(clips))
    asked = {"training": training.model_dump(mode="json"), "width": effort.width}
    config = QualityConfig(features=tokenizer.mean.numel(), width=effort.width)
    kept(folder, asked, lambda: train_quality(levels, folder, training, config=config))
    return QualityReward.load(folder)


def _alignment(workshop: Workshop, clips: dict[str, TokenClip]) -> AudioMotion:
    folder, effort = workshop.folder / "rewards" / "alignment", EFFORTS[workshop.scale.name]
    training = AudioRewardTraining(steps=effort.alignment_steps, seed=workshop.seed)
    books = workshop.codec.codebooks.detach(), workshop.tokenizer(OURS).codebooks().detach()
    pairs = Pairs(clips, chunks=_window(clips))
    asked = {"training": training.model_dump(mode="json"), "width": effort.width}

    def work() -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(workshop.seed)
            model = AudioMotion.over(*books, width=effort.width)
        train_audio_reward(model, pairs, folder, training)

    kept(folder, asked, work)
    return AudioMotion.load(folder)


def _window(clips: dict[str, TokenClip]) -> int:
    """4 s, or less where the clips are shorter."""
    return min(WINDOW_CHUNKS, *(clip.chunks for clip in clips.values()))


def _rank(workshop: Workshop, ready: Setting, path: Path, training: AlignTraining) -> None:
    make_pairs(
        ready,
        path,
        prompts=EFFORTS[workshop.scale.name].prompts,
        past=training.past,
        length=training.length,
        group=8,
        margin=0.0,
        fewest_events=training.fewest_events,
        seed=workshop.seed,
        progress=workshop.progress,
    )


def _move(workshop: Workshop, folder: Path) -> None:
    """What the tuned generator of a folder makes of the test clips' sound."""
    from echoavatar.engine import animate_many
    from echoavatar.pipeline import Pipeline
    from echoavatar.pipeline.bundle import Bundle

    generator = Generator.load(folder).eval()
    pipeline = Pipeline(Bundle(folder.name, workshop.codec, workshop.tokenizer(OURS), generator, {}))
    for first in range(0, len(workshop.tests), TOGETHER):
        clips = workshop.tests[first : first + TOGETHER]
        seeds = list(range(workshop.seed + first, workshop.seed + first + len(clips)))
        done = animate_many(pipeline, [clip.audio for clip in clips], seeds=seeds, progress=workshop.progress)
        for clip, one in zip(clips, done, strict=True):
            moved = replace(clip, rotations=one.motion.rotations, root=one.motion.root)
            moved.save(folder / "made" / f"{clip.name}.npz")


def _folder(workshop: Workshop, method: Method) -> Path:
    return workshop.folder / "alignment" / method


def _scored(workshop: Workshop, motions: list[Motion]) -> dict[str, Cell]:
    return cells(generated(motions, workshop.tests, workshop.extractor, seed=workshop.seed), GENERATION)
