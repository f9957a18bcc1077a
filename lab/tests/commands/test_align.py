"""`echoavatar align` end to end on a bundle of random weights."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import clips, save_clips
from lab.tests.evaluation.test_alive import swaying
from lab.tests.evaluation.test_takes import name_people

from echoavatar.cli import main
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.align import target_task, targets
from echoavatar_lab.align.compare import compare
from echoavatar_lab.models.generator.model import Generator


def test_pairs_then_dpo_and_grpo_from_the_command_line(tmp_path, tiny_bundle, capsys):
    tokens = save_clips(tmp_path / "tokens", 3, 8)
    reference_statistics().save(tmp_path / "y.json")
    common = [
        str(tokens),
        "--model",
        str(tiny_bundle),
        "--reference-statistics",
        str(tmp_path / "y.json"),
        "--reward",
        "liveliness=1",
    ]
    pairs = str(tmp_path / "pairs.jsonl")
    sizes = ["--past", "1", "--length", "1", "--fewest-events", "0", "--margin", "0", "--prompts", "3"]
    assert main(["align", "rollouts", *common, "-o", pairs, *sizes]) == 0
    assert "pairs in" in capsys.readouterr().out
    small = ["--recipe", "tiny", "--steps", "1"]
    assert main(["align", "dpo", *common, "-o", str(tmp_path / "dpo"), "--pairs", pairs, *small]) == 0
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "grpo"), *small, "--kl-weight", "0.5"]) == 0
    card = json.loads((tmp_path / "grpo" / "card.json").read_text())
    assert card["alignment"]["kl_weight"] == 0.5
    assert card["command"].startswith("echoavatar align grpo")
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "bad"), "--reward", "nonsense=1", *small]) == 1
    assert "no reward 'nonsense'" in capsys.readouterr().err
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "bad"), "--reward", "quality=1", *small]) == 1
    assert "the reward quality is learned first: pass --quality" in capsys.readouterr().err


def test_generators_side_by_side(tmp_path: Path, tiny_bundle: Path, capsys, monkeypatch) -> None:
    folder = save_clips(tmp_path / "tokens", 3, 8, held_out=True)
    reference_statistics().save(tmp_path / "reference_statistics.json")
    words = ["--model", str(tiny_bundle), "--reference-statistics", str(tmp_path / "reference_statistics.json")]
    words += ["--reward", "smoothness=1", "--prompts", "2", "--group", "2", "--past", "2", "--length", "4"]
    again = tmp_path / "again"
    shutil.copytree(tiny_bundle / "generator", again)
    both = [str(tiny_bundle / "generator"), str(again)]
    words += ["--beside", *both, "--device", "cpu", "-o", str(tmp_path / "found.json")]
    asked = []
    monkeypatch.setattr("echoavatar_lab.commands.align.compare", lambda *a, **b: asked.append(b) or compare(*a, **b))
    assert main(["align", "compare", str(folder), *words]) == 0
    told = json.loads((tmp_path / "found.json").read_text())
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == told
    assert list(told["found"]) == ["truth", "untuned", *both]
    assert told["over_seeds"][", ".join(both)]["gain"] == [0.0, 0.0, 0.0]
    assert asked[0]["device"] == "cpu"
    assert len((tmp_path / "found.md").read_text().splitlines()) == 5
    assert told["prompts"] == 2


def test_a_soup_of_two_runs(tmp_path, tiny_bundle, capsys):
    start = Generator.load(tiny_bundle / "generator")
    for name, by in (("a", 1.0), ("b", 2.0)):
        tuned = Generator(start.config)
        tuned.load_state_dict({key: value + by for key, value in start.state_dict().items()})
        tuned.save(tmp_path / name, {"kind": "generator", "licence": "CC0-1.0", "step": 3})
    shares = {str(tmp_path / "a"): 0.5, str(tmp_path / "b"): 0.25}
    words = [f"{run}={share}" for run, share in shares.items()]
    assert main(["align", "soup", *words, "-o", str(tmp_path / "mix"), "--model", str(tiny_bundle)]) == 0
    assert "2 runs mixed in" in capsys.readouterr().out
    card = json.loads((tmp_path / "mix" / "card.json").read_text())
    assert (card["shares"], card["licence"]) == (shares, "CC0-1.0")
    mixed = Generator.load(tmp_path / "mix")
    torch.testing.assert_close(mixed.lm_head.weight, start.lm_head.weight + 1.0)
    assert main(["align", "soup", str(tmp_path / "a"), "-o", str(tmp_path / "bad"), "--model", str(tiny_bundle)]) == 1
    assert "a' is not NAME=WEIGHT, such as runs/a=0.5" in capsys.readouterr().err


@pytest.fixture
def words(tmp_path: Path, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(target_task, "TRUTH_DRAWS", 2)
    monkeypatch.setattr(target_task, "TOGETHER", 16)
    monkeypatch.setattr(target_task, "ROUNDS", 1)
    (tmp_path / "tokens").mkdir()
    for number, clip in enumerate(clips(6, 40).values()):
        object.__setattr__(clip, "domain", np.full_like(clip.domain, 1 + number % 2))
        clip.cues[30::37, 1] = clip.cues[31::37, 1] = 1
        clip.save(tmp_path / f"tokens/{number}.npz")
    (tmp_path / "people").mkdir()
    for name, size in (("dance_a", 0.2), ("dance_b", 0.4)):
        motion = swaying(400, size=size)
        write_bvh(tmp_path / "people" / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    name_people(tmp_path / "people", *(("music", name, "any", name) for name in ("dance_a", "dance_b")))
    sizes = ["--past", "6", "--own-past", "1", "--length", "28", "--batch", "4", "--group", "2", "--accumulation", "2"]
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
    monkeypatch.setattr(targets, "FEWEST_WINDOWS", 4)

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
