"""From the command line to a tuned generator, stopped and resumed."""

import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.align.tuning_fakes import clips
from lab.tests.evaluation.test_alive import swaying

from echoavatar.cli import main
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.align.tuning import opponent


@pytest.fixture
def words(tmp_path: Path, tiny_bundle: Path) -> list[str]:
    (tmp_path / "tokens").mkdir()
    for number, clip in enumerate(clips(6, 40).values()):
        object.__setattr__(clip, "domain", np.full_like(clip.domain, 1 + number % 2))
        clip.cues[30::37, 1] = clip.cues[31::37, 1] = 1
        clip.save(tmp_path / f"tokens/{number}.npz")
    (tmp_path / "people").mkdir()
    for name, size in (("dance_a", 0.2), ("dance_b", 0.4)):
        motion = swaying(400, size=size)
        write_bvh(tmp_path / "people" / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    sizes = ["--past", "6", "--own-past", "1", "--length", "28", "--batch", "8", "--group", "2", "--accumulation", "2"]
    sizes += ["--layers", "1"]
    return [
        "align",
        "targets",
        str(tmp_path / "tokens"),
        "--model",
        str(tiny_bundle),
        "--captured",
        str(tmp_path / "people"),
        *sizes,
    ]


def test_a_stopped_run_goes_on_as_if_it_had_not_stopped(
    tmp_path: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opponent, "FEWEST", 4)

    def lines(folder: str, steps: int) -> list[dict[str, float]]:
        assert main([*words, "-o", str(tmp_path / folder), "--steps", str(steps), "--save-every", "1"]) == 0
        return [json.loads(line) for line in (tmp_path / folder / "metrics.jsonl").read_text().splitlines()]

    whole = lines("whole", 3)
    lines("stopped", 2)
    resumed = lines("stopped", 3)
    assert [line["step"] for line in resumed] == [1, 2, 3]
    for name in ("reward", "kl", "weight.music.beats", "weight.speech.room", "rest", "music.told_apart"):
        assert resumed[2][name] == pytest.approx(whole[2][name], rel=1e-6), name
    assert {"music.shoulder_turn", "speech.jerk", "rewards.realism"} <= whole[0].keys()
    assert (tmp_path / "whole/model.safetensors").exists()


def test_the_sampling_that_it_is_tuned_for_is_saved(tmp_path: Path, words: list[str]) -> None:
    sampling = ["--temperature", "0.9", "--cooling", "0.8"]
    assert main([*words, "-o", str(tmp_path / "run"), "--steps", "1", "--save-every", "1", *sampling]) == 0
    saved = json.loads((tmp_path / "run/config.json").read_text())
    assert (saved["temperature"], saved["cooling"]) == (0.9, 0.8)


def test_token_files_of_one_kind_of_sound_are_refused(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (tmp_path / "tokens").glob("*[024].npz"):
        path.unlink()
    assert main([*words, "-o", str(tmp_path / "run"), "--steps", "1"]) == 1
    assert "filled with speech: use token files of both kinds of sound" in capsys.readouterr().err


@pytest.mark.parametrize(("option", "least"), [("--past", 5), ("--length", 28)])
def test_sizes_that_cannot_be_measured_are_refused(
    words: list[str], option: str, least: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "-o", "unused", option, "4"]) == 1
    assert f"{option} 4 is too short: at least {least} chunks" in capsys.readouterr().err
