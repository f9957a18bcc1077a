"""Two tables of learned rewards: what tuning by them gains and costs, and whether sound finds its own motion.

`alignment` is the paper's alignment-fidelity trade-off: the same generator untuned, and tuned by DPO, GRPO and PPO.
Both learned rewards are trained on the corpus first, in the paper's form: quality by the features alone, alignment by
BEATs (`--beats`) and one embedding of the clip. Each method then tunes the generator of the main table's last line by
the sum of the rewards, on sounds of a corpus without motion (paper, RL Alignment Corpus; `--sounds`, or one is made).
The paper's DPO learns from people; ours learns from pairs ranked by the same rewards. Rewards are measured on prompts
of the held-out clips, the same for all lines; everything else on the test clips, through the live pipeline.

`retrieval` is the paper's table "Retrieval ability of the audio-motion contrastive space". The alignment reward is
trained on the training clips and asked about windows of the other clips that do not overlap. The paper has galleries of
1,808 and 300 windows; ours are as large as the held-out clips allow, and their size is told. Its "small batches" are
one gallery of 300: all their entries are multiples of 1/300.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import NamedTuple

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.align.audio_reward_train import (
    WINDOW_CHUNKS,
    AudioMotionWindows,
    AudioRewardTask,
    AudioRewardTraining,
    decoded_features,
    decoded_waveforms,
    embed,
    untrained,
)
from echoavatar_lab.align.prompts import read_token_clips, train_and_test
from echoavatar_lab.align.quality import CorruptedWindows, QualityConfig, QualityReward, QualityTask, QualityTraining
from echoavatar_lab.align.rewards import ReferenceStatistics, RewardMix
from echoavatar_lab.align.start import AlignmentSetup, make_pairs, training_task, tune
from echoavatar_lab.align.trainer import AlignTraining, Method, fingerprint, recipe
from echoavatar_lab.data import SoundSet
from echoavatar_lab.evaluation.metrics.retrieval import PAPER_GALLERY, Retrieval, chance, gallery, retrieval, similarity
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import tokenize_sounds
from echoavatar_lab.paper import REWARDS
from echoavatar_lab.training import train
from echoavatar_lab.training.metrics_log import FILE, read_metrics

from .experiment import Experiment, make_once
from .scale import OURS, GeneratorChoice, Part, generator_waves
from .scores import GENERATION_COLUMNS, generation_cells, papers
from .table import Cell, Claim, Column, Line, Table

NAME = "alignment"
NORMAL = 1.96  # standard errors of a 95 % interval
COLUMNS = (
    *GENERATION_COLUMNS,
    Column("quality", "Quality reward", better="higher"),
    Column("alignment", "Alignment reward", better="higher"),
    Column("kl", "KL", "nats a code"),
)
UNTUNED = ("Ours (no RL)", papers(9.465, 20.70, 8.277, 2.603))
LINES: dict[Method, tuple[str, dict[str, float]]] = {
    "dpo": ("Ours (DPO)", papers(12.39, 19.67, 8.283, 2.607)),
    "grpo": ("Ours (GRPO)", papers(24.13, 20.89, 8.239, 2.618)),
    "ppo": ("Ours (PPO)", papers(24.97)),
}
CLAIMS = (
    *(Claim(UNTUNED[0], LINES[method][0], ("fid",)) for method in ("dpo", "grpo", "ppo")),  # the trade-off
    Claim(LINES["dpo"][0], LINES["grpo"][0], ("fid",)),
    Claim(LINES["grpo"][0], UNTUNED[0], tuple(REWARDS)),
)
NO_STATISTICS = ReferenceStatistics(
    beat=(0.0,), stress=(0.0,), speed=(0.0,) * 3, movement=((0.0,) * 4,) * 3, jerk=1.0, scenes=1
)
"""Learned rewards need no reference statistics."""


class TunedOutcome(NamedTuple):
    """A tuned generator's motion for the test clips, and its rewards."""

    motions: list[Motion]
    rewards: dict[str, Cell]


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`: the generator, both rewards, the three methods."""
    return [*generator_waves([GeneratorChoice(OURS.name)]), [_setting], [partial(tuned, method=one) for one in LINES]]


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    lines = [Line("GT", {}, generation_cells(experiment, experiment.true_motions))]
    experiment.say(f"line: {UNTUNED[0]}")
    untuned = generation_cells(experiment, experiment.generated_motions(GeneratorChoice(OURS.name)))
    lines.append(Line(UNTUNED[0], UNTUNED[1], untuned))
    for method, (name, paper) in LINES.items():
        experiment.say(f"line: {name}")
        found = tuned(experiment, method)
        scores = generation_cells(experiment, found.motions) | found.rewards
        lines.append(Line(name, paper, scores))
    lines[1] = replace(lines[1], ours=untuned | rewards_of(_folder(experiment, "grpo"), is_first=True))
    notes = (
        "Rewards: cosine of sound and motion, and motion quality, both learned, summed with equal weights; on "
        "held-out prompts. In brackets: 95 % intervals over prompts.",
        "The paper's DPO learns from people, ours from continuations ranked by the same rewards.",
        f"Prompts to learn from: {_told_sounds(experiment)}.",
        f"Tuned for {_training(experiment, 'grpo').steps} steps with the recipe of the scale.",
    )
    return Table(
        NAME, "Alignment against fidelity (paper, RL Strategy Analysis and PPO)", COLUMNS, lines, notes, CLAIMS
    )


def _told_sounds(experiment: Experiment) -> str:
    given, scale = experiment.sources.sounds, experiment.scale
    if given is not None:
        return f"sounds of {given.name}"
    return f"{scale.speech_hours:g} hours of speech and {scale.pieces} pieces of music, made by `data rl-corpus`"


def tuned(experiment: Experiment, method: Method) -> TunedOutcome:
    """Tune the generator of the main table's last line by a method and generate motion for the test clips."""
    folder, training = _folder(experiment, method), _training(experiment, method)
    ready = _setting(experiment)
    settings = {
        "generator": fingerprint(ready.generator),
        "training": training.model_dump(mode="json"),
        "rewards": _reward_settings(experiment),
        "sounds": _sound_settings(experiment),
    }

    def work() -> None:
        pairs = None
        if method == "dpo":
            pairs = folder / "pairs.jsonl"
            if not pairs.exists():
                make_pairs(ready, pairs, training, prompts=experiment.scale.pairs, progress=experiment.progress)
        task = training_task(method, training, ready, pairs=pairs, command="echoavatar reproduce alignment")
        tune(task, folder, device=experiment.device, trackers=experiment.trackers, progress=experiment.progress)

    make_once(folder, settings, work)
    motions = folder / "made" / experiment.runtime
    make_once(
        motions,
        settings | {"runtime": experiment.runtime, "clips": [clip.name for clip in experiment.test_clips]},
        lambda: experiment.write_motions(motions, experiment.tokenizer(OURS), Generator.load(folder)),
    )
    return TunedOutcome(experiment.written_motions(motions), rewards_of(folder))


def rewards_of(folder: Path, *, is_first: bool = False) -> dict[str, Cell]:
    """Both rewards and the KL divergence on held-out prompts, from the last measurement of a run or from the first."""
    probe = [line["held_out"] for line in read_metrics(folder / FILE) if "held_out" in line][0 if is_first else -1]
    found = {name: probe["rewards"][name] for name in REWARDS}
    made = {name: Cell(mean, mean - NORMAL * error, mean + NORMAL * error) for name, (mean, error) in found.items()}
    return made | {"kl": Cell(probe["kl"])}


def _training(experiment: Experiment, method: Method) -> AlignTraining:
    """The recipe of the scale, with the scale's own numbers and the experiment's seed."""
    own = experiment.scale.tuning | {"seed": experiment.seed}
    return AlignTraining.model_validate(recipe(experiment.scale.name, method).model_dump() | own)


def _setting(experiment: Experiment) -> AlignmentSetup:
    generator = experiment.generator(GeneratorChoice(OURS.name))
    train_clips, test_clips = token_clips(experiment)
    own = {
        "quality": _quality(experiment, train_clips).judge,
        "alignment": alignment_reward(experiment, train_clips).judge,
    }
    mix = RewardMix(REWARDS, NO_STATISTICS, own)
    card: dict[str, object] = {"data": experiment.corpus.folder.name, "begun_from": OURS.name}
    prompts = _prompt_clips(experiment, generator)
    return AlignmentSetup(
        experiment.tokenizer(OURS), generator, copy.deepcopy(generator), "no RL", prompts, test_clips, mix, card
    )


def token_clips(experiment: Experiment) -> tuple[dict[str, TokenClip], dict[str, TokenClip]]:
    """Codes of the training clips and of the other clips, by name; mirrored ones too."""
    experiment.codes(OURS)
    folder = experiment.folder / "tokens" / OURS.name
    return train_and_test(read_token_clips(folder), folder)


def _prompt_clips(experiment: Experiment, generator: Generator) -> dict[str, TokenClip]:
    """Codes of the sounds that the generator is tuned on: the user's, or some that are made."""
    folder = experiment.folder / "tokens" / "sounds"

    def work() -> None:
        sounds = SoundSet(experiment.sources.sounds or _made_sounds(experiment))
        has_past = any(_training(experiment, method).past for method in LINES)
        tokenize_sounds(
            sounds,
            experiment.codec,
            generator,
            folder,
            seed=experiment.seed,
            has_past=has_past,
            progress=experiment.progress,
        )

    make_once(folder, _sound_settings(experiment) | {"generator": fingerprint(generator)}, work)
    return train_and_test(read_token_clips(folder), folder)[0]


def _made_sounds(experiment: Experiment) -> Path:
    from echoavatar_lab.datasets.rl_corpus import SoundPlan, make_rl_corpus
    from echoavatar_lab.datasets.text_to_speech import text_to_speech

    folder, scale = experiment.folder / "sounds", experiment.scale
    make_rl_corpus(SoundPlan(folder, text_to_speech("auto"), scale.speech_hours, scale.pieces, experiment.seed))
    return folder


def _sound_settings(experiment: Experiment) -> dict[str, object]:
    given, scale = experiment.sources.sounds, experiment.scale
    return {"sounds": given.name} if given else {"hours": scale.speech_hours, "pieces": scale.pieces}


def _quality(experiment: Experiment, clips: dict[str, TokenClip]) -> QualityReward:
    folder = experiment.folder / "rewards" / "quality"
    tokenizer = experiment.tokenizer(OURS)
    config, training = quality_settings(experiment, tokenizer.mean.numel())
    levels = CorruptedWindows(tokenizer, list(clips.values()), seed=experiment.seed, chunks=reward_window(clips))
    settings = _reward_settings(experiment)
    make_once(folder, settings, lambda: train(QualityTask(levels, config, training), folder).model)
    return QualityReward.load(folder)


def quality_settings(experiment: Experiment, features: int) -> tuple[QualityConfig, QualityTraining]:
    """Sizes of the quality reward of motion of so many features, and how it is trained."""
    scale = experiment.scale
    return (
        scale.quality.model_copy(update={"features": features}),
        scale.quality_training.model_copy(update={"seed": experiment.seed}),
    )


def alignment_reward(experiment: Experiment, clips: dict[str, TokenClip]) -> AudioMotion:
    """The reward that compares sound and motion, trained or loaded.

    Raises EchoAvatarError if the paper's scale needs BEATs, and none is given.
    """
    folder = experiment.folder / "rewards" / "alignment"
    if experiment.scale.name == "paper" and experiment.sources.beats is None:
        raise EchoAvatarError("scale paper hears with the published BEATs: give BEATs_iter3_plus_AS2M.pt as --beats")

    def work() -> None:
        model, training = alignment_settings(experiment)
        train(AudioRewardTask(model, _windows(experiment, clips), training), folder)

    make_once(folder, _reward_settings(experiment), work)
    return AudioMotion.load(folder)


def alignment_settings(experiment: Experiment) -> tuple[AudioMotion, AudioRewardTraining]:
    """The untrained alignment reward, and how it is trained."""
    scale, sources = experiment.scale, experiment.sources
    model = untrained(
        experiment.codec,
        experiment.tokenizer(OURS),
        encoder="beats",
        weights=sources.beats,
        seed=experiment.seed,
        **scale.alignment.model_dump(exclude={"audio_encoder", "motion_channels"}),
    )
    return model, scale.alignment_training.model_copy(update={"seed": experiment.seed})


def _windows(experiment: Experiment, clips: dict[str, TokenClip], chunks: int | None = None) -> AudioMotionWindows:
    """Windows of waves and motion features, `chunks` long or as the rewards' own."""
    waves = decoded_waveforms(experiment.codec, clips, experiment.progress)
    features = decoded_features(experiment.tokenizer(OURS), clips, experiment.progress)
    return AudioMotionWindows(clips, chunks=chunks or reward_window(clips), waves=waves, features=features)


def _reward_settings(experiment: Experiment) -> dict[str, object]:
    """What the rewards depend on; one that was trained on other codes is refused."""
    names = ("quality", "quality_training", "alignment", "alignment_training")
    settings = experiment.scale.model_dump(mode="json", include=set(names))
    beats = experiment.sources.beats
    return settings | {"beats": beats.name if beats else None, "codes": experiment.codes_settings(OURS)}


def reward_window(clips: dict[str, TokenClip]) -> int:
    """The window of both rewards in chunks: 4 s, or less if the clips are shorter."""
    return min(WINDOW_CHUNKS, *(clip.chunks for clip in clips.values()))


def _folder(experiment: Experiment, method: Method) -> Path:
    return experiment.folder / "alignment" / method


RETRIEVAL = "retrieval"
KS = (1, 3, 5, 10)
WAYS = {"a2m": "audio to motion", "m2a": "motion to audio"}
RETRIEVAL_COLUMNS = tuple(
    column
    for way, told in WAYS.items()
    for column in (
        *(Column(f"{way}_r{k}", f"R@{k}, {told}", "%", better="higher") for k in KS),
        Column(f"{way}_medr", f"MedR, {told}"),
        Column(f"{way}_mrr", f"MRR, {told}", "%", better="higher"),
    )
)


class Quoted(NamedTuple):
    """A line of the paper: protocol, model, and R@1, 3, 5, 10, MedR, MRR in both directions."""

    name: str
    a2m: tuple[float, ...]
    m2a: tuple[float, ...]


QUOTED = (
    Quoted("All (1808), BEATs", (6.42, 10.51, 14.60, 21.79, 67.0, 11.07), (6.64, 10.51, 13.77, 18.75, 75.0, 10.70)),
    Quoted("All (1808), Wav2CLIP", (3.60, 6.58, 9.13, 13.05, 169.0, 7.00), (3.48, 5.86, 8.52, 12.06, 184.0, 6.57)),
    Quoted("All (1808), random", (0.06, 0.17, 0.28, 0.55, 904.0, 0.41), (0.06, 0.17, 0.28, 0.55, 904.0, 0.41)),
    Quoted("300, BEATs", (18.67, 27.33, 33.33, 44.00, 15.0, 26.49), (21.67, 30.00, 34.67, 44.00, 13.0, 28.37)),
    Quoted("300, Wav2CLIP", (9.00, 13.67, 17.67, 28.67, 23.5, 15.69), (6.33, 11.67, 16.00, 24.67, 37.5, 12.14)),
    Quoted("300, random", (0.33, 1.00, 1.67, 3.33, 150.0, 2.09), (0.33, 1.00, 1.67, 3.33, 150.0, 2.09)),
)


def retrieval_waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`."""
    return [[methodcaller("codes", OURS)], [_train_reward]]


def _train_reward(experiment: Experiment) -> None:
    alignment_reward(experiment, token_clips(experiment)[0])


def make_retrieval(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    train_clips, held_out = token_clips(experiment)
    experiment.say("line: Ours")
    chunks = reward_window(train_clips)
    model = alignment_reward(experiment, train_clips)
    sounds, motions = embed(model, _windows(experiment, held_out, chunks))
    if len(sounds) < 2:
        raise EchoAvatarError(
            f"{experiment.corpus.folder} has {len(sounds)} held-out windows of {chunks} chunks; retrieval needs two:"
            " give a set with longer test clips"
        )
    toward, back = similarity(sounds, motions), similarity(motions, sounds)
    lines = [Line(f"{one.name} (quoted)", _quoted(one)) for one in QUOTED]
    lines += _retrieval_lines(f"all ({len(toward)})", retrieval(toward, KS), retrieval(back, KS))
    if len(toward) > PAPER_GALLERY:
        both = (gallery(matrix, seed=experiment.seed) for matrix in (toward, back))
        lines += _retrieval_lines(f"{PAPER_GALLERY}", *both)
    heard = "the published BEATs" if experiment.sources.beats else "a small BEATs that learned along"
    notes = (
        f"Windows of {chunks} chunks of 0.267 s that do not overlap, of the clips that are not for training; the"
        " paper's windows are of 4 s.",
        f"Our ears: {heard}, on sound that the codec decodes; the paper's are BEATs and Wav2CLIP.",
        "The paper's random MRR among 1,808 is 0.41 where H(1808)/1808 is 0.447.",
    )
    return Table(
        RETRIEVAL,
        "Retrieval of audio and motion (paper, Audio-Motion Alignment Reward)",
        RETRIEVAL_COLUMNS,
        lines,
        notes,
    )


def _retrieval_lines(protocol: str, toward: Retrieval, back: Retrieval) -> list[Line]:
    guess = chance(toward.gallery, KS)
    return [
        Line(f"Ours, {protocol}", {}, _retrieval_cells("a2m", toward) | _retrieval_cells("m2a", back)),
        Line(f"Chance, {protocol}", {}, _retrieval_cells("a2m", guess) | _retrieval_cells("m2a", guess)),
    ]


def _retrieval_cells(way: str, found: Retrieval) -> dict[str, Cell]:
    recalls = {f"{way}_r{k}": Cell(found.recall[k]) for k in KS}
    return recalls | {f"{way}_medr": Cell(found.median_rank), f"{way}_mrr": Cell(found.reciprocal_rank)}


def _quoted(line: Quoted) -> dict[str, float]:
    kinds = [*(f"r{k}" for k in KS), "medr", "mrr"]
    sides = (("a2m", line.a2m), ("m2a", line.m2a))
    return {f"{way}_{kind}": value for way, values in sides for kind, value in zip(kinds, values, strict=True)}
