"""The paper's recipes against the paper's numbers, which `paper_numbers.csv` holds as typed from it, with their places.

What `reproduce` builds: `lab/tests/test_paper.py`. A row that nothing holds serves `tests/docs/test_paper_index.py`.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import pytest
from lab.tests.recipes.paper_numbers import number, rows

from echoavatar import timing
from echoavatar.config import Config
from echoavatar.models.face import FaceConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.audio_reward import AudioMotionConfig
from echoavatar_lab.align.corruption import PAPER_CLEAN_FID, PAPER_FID, PAPER_SCORES, PAPER_TRUTH, RATES, paper_scores
from echoavatar_lab.align.trainer import recipe
from echoavatar_lab.commands import align_rewards, train
from echoavatar_lab.commands.train_body import body_sizes
from echoavatar_lab.models.face.train import FaceTraining
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.models.tokenize import TokenSettings
from echoavatar_lab.models.tokenizer.train import TokenizerTraining

ROOT = Path(__file__).parents[3]
TRAINING: dict[str, type[Config]] = {
    "tokenizer": TokenizerTraining, "generator": GeneratorTraining, "face": FaceTraining, "tokens": TokenSettings
}  # fmt: skip


def settings_of(stem: str) -> tuple[Any, Any]:
    """Sizes (the first tokenizer's) and training of a paper recipe, as `train` understands its file."""
    kind = stem.partition("_")[0]
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    words = [kind, "SOURCE", "-o", "OUT", "--recipe", str(ROOT / "lab/recipes/paper" / f"{stem}.yaml")]
    words += ["--codec", "C", "--tokenizer", "T"] if kind in ("generator", "tokens") else []
    args = parser.parse_args(words)
    settings = args.options.settings(args)
    training = settings.checked(TRAINING[kind], "training")
    if kind == "tokens":
        return None, training
    if kind == "tokenizer":
        parts = list(body_sizes(settings, HUMANOID).parts.values())
        for name in ("codes", "width", "layers", "resampling", "blocks"):
            assert len({getattr(part, name) for part in parts}) == 1, f"the parts differ in {name}"
        return parts[0], training
    return settings.checked(FaceConfig if kind == "face" else GeneratorConfig, "model"), training


def found(held_by: str) -> list[Any]:
    """What the code has where the row says."""
    first, *rest = held_by.split()
    if first == "timing":
        return [getattr(timing, rest[0])]
    if first == "JITTER_SECONDS":
        text = (ROOT / "web/packages/client/src/player.ts").read_text()
        return [float(text.partition("JITTER_SECONDS = ")[2].partition(";")[0])]
    if first == "score":
        return [paper_scores()[" ".join(rest)]]
    if first == "AudioMotionConfig":
        return [AudioMotionConfig.model_fields[rest[0]].default]
    if first in ("reward-alignment", "reward-quality"):
        given = align_rewards.chosen(reward_settings(first), rest[0])
        return [given[rest[0]] if rest[0] in given else AudioMotionConfig.model_fields[rest[0]].default]
    if first.startswith("align-"):
        return [getattr(recipe("paper", name.removeprefix("align-")), rest[-1]) for name in (first, *rest[:-1])]  # type: ignore[arg-type]
    values = []
    for stem in (first, *rest[:-1]):
        model, training = settings_of(stem)
        value: Any = {"model": model, "training": training}
        for part in rest[-1].split("."):
            value = value[part] if isinstance(value, dict) else getattr(value, part)
        values.append(value)
    return values


def reward_settings(kind: str) -> argparse.Namespace:
    """The options of a reward's command under `--paper`."""
    parser = argparse.ArgumentParser()
    align_rewards.add_arguments(parser.add_subparsers(dest="kind"))
    return parser.parse_args([kind, "TOKENS", "-o", "OUT", "--paper"])


@pytest.mark.parametrize("row", [row for row in rows() if row["held by"]], ids=lambda row: row["what"])
def test_the_recipe_has_the_papers_number(row: dict[str, str]) -> None:
    for value in found(row["held by"]):
        if isinstance(value, str):
            assert value == row["value"]
        else:
            assert math.isclose(value, float(row["value"]), rel_tol=1e-9), f"{row['where in the paper']}: {value}"


def test_every_row_says_where_and_names_are_unique() -> None:
    assert all(row["what"] and row["value"] and row["where in the paper"] for row in rows())
    assert len({row["what"] for row in rows()}) == len(rows()) > 150


def test_a_window_has_the_papers_tokens() -> None:
    """Settings: 4 s, 600 audio tokens, 540 motion tokens of six layers in three parts."""
    layout = compact_layout(audio_codes=1024, motion_layers=int(number("quantization depth Q")), motion_codes=512)
    for stage in (1, 2, 3):
        config, _ = settings_of(f"generator_stage{stage}")
        order = config.model_copy(update={"layout": layout}).order
        assert layout.audio_layers == number("RVQ layers of EnCodec")
        assert config.window_chunks * order.audio_per_chunk == number("audio tokens of a window")
        assert config.window_chunks * order.motion_per_chunk == number("motion tokens of a window")
        seconds = config.window_chunks * timing.CHUNK_FRAMES / timing.FRAME_RATE_HZ
        assert seconds == number("window in seconds")
    rate = timing.FRAME_RATE_HZ / timing.FRAMES_PER_MOTION_TOKEN
    assert rate == number("motion tokens per second")


def test_what_the_paper_does_not_have_is_off() -> None:
    """Every departure of training that docs/paper_index.md lists."""
    model, training = settings_of("tokenizer")
    assert (training.is_principal_start, training.is_scaled_by_reach, training.quantize_from) == (False, False, 0)
    assert model.kmeans_steps == 0
    assert not training.is_mirrored
    assert settings_of("tokens")[1] == TokenSettings(patience=0, is_leveled=False, is_mirrored=False)
    for stage in (1, 2, 3):
        model, training = settings_of(f"generator_stage{stage}")
        assert (training.cue_weight, training.blind, training.out_of_step, training.other_past) == (0, 0, 0, 0)
        assert training.optimiser == "adamw"
        assert (model.ahead_chunks, model.patience) == (0, 0)
        assert list(training.depth_weights) == sorted(training.depth_weights, reverse=True)
        assert len(training.depth_weights) == number("quantization depth Q")
    assert settings_of("generator_stage1")[1].objective == "streams"
    assert settings_of("generator_stage2")[1].short_windows == settings_of("generator_stage3")[1].short_windows == 0
    assert settings_of("generator_stage3")[1].exemplar > 0
    face, training = settings_of("face")
    assert (training.history_noise, training.history_dropout, training.gain_db, training.lips) == (0, 0, 0, 0)
    assert (training.listen, training.readout, training.high_noise, training.tempo) == (0, 0, 1, True)
    assert (face.noise_hold, face.late, face.memory) == (1, 0, "window")


def test_the_quality_scores_and_fids_are_those_of_the_table() -> None:
    assert number("score of truth") == PAPER_TRUTH
    assert number("FID of reconstruction") == PAPER_CLEAN_FID
    for kind, scores in PAPER_SCORES.items():
        for rate, score, fid in zip(RATES, scores, PAPER_FID[kind], strict=True):
            assert score == number(f"score of {kind} {rate}")
            assert fid == number(f"FID of {kind} {rate}")
