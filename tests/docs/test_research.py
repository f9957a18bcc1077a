"""Every command of docs/research.md exists with its options, and its estimates are computed correctly."""

import argparse
import glob
import re
import shlex
import shutil
from pathlib import Path

import pytest
from lab.tests.datasets.samples import gesture, motorica_names, renamed, speech, write_beat2, write_lda, write_motion
from lab.tests.evaluation.clips import clicks

from echoavatar.cli import COMMANDS, command_module, main
from echoavatar.models.audio import write_wav
from echoavatar_lab.data import Corpus
from echoavatar_lab.datasets.layouts import MOTORICA_TEST
from echoavatar_studio.settings import read_study

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/research.md").read_text()


def commands() -> list[str]:
    lines = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, re.S) for line in block.strip().splitlines()]
    return [re.sub(r"^accelerate launch --num_processes \d+ -m ", "", line) for line in lines]


@pytest.mark.parametrize("line", commands())
def test_every_command_exists_with_its_options(line: str) -> None:
    program, command, *words = shlex.split(line, comments=True)
    assert (program, command in COMMANDS) == ("echoavatar", True)
    parser = argparse.ArgumentParser(exit_on_error=False)
    command_module(command).add_arguments(parser)
    args = parser.parse_args(words)
    assert (ROOT / args.recipe).is_file() if str(getattr(args, "recipe", "")).endswith(".yaml") else True


def test_every_link_leads_somewhere() -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", TEXT):
        assert (ROOT / "docs" / target).exists(), target


def test_the_sums_are_right() -> None:
    """Repeats the arithmetic of the estimates."""
    step = (6 * 0.358e9 + 12 * 24 * 896 * 1140) * 1140 * 256
    seconds = step / (0.35 * 989e12)
    assert f"{seconds:.2f} s a step" in TEXT
    total = 0.0
    for stage, steps, each in (1, 5_000, seconds * 2 / 3), (2, 40_000, seconds), (3, 10_000, seconds):
        hours = steps * each / 3600
        total += hours
        one, two, eight = (f"{hours / times:.1f} h" for times in (1, 1.9, 7.2))
        assert f"| stage {stage} | {steps:,} x {each:.2f} s | {one} | {two} | {eight} |" in TEXT
    assert "| " + " | ".join(f"**{total / times:.1f} h**" for times in (1, 1.9, 7.2)) + " |" in TEXT
    assert f"= {(52 * 16 + 13 + 1600) * 108_000 / 1e6:.0f} MB an hour" in TEXT


NOT_RUN = {
    "data rl-corpus": "its speech comes from a paid service",
    "align reward-quality": "a thousand steps and more; `reproduce alignment` trains it",
    "align reward-alignment": "a thousand steps and more; `reproduce alignment` trains it",
    "bench train": "its own test runs it",
    "bench stream": "its own test runs it",
    "bench sessions": "its own test runs it",
    "align grpo": "its sounds come from data rl-corpus; `reproduce alignment` runs GRPO",
}


def small(line: str) -> str:
    """The same command at scale tiny, without GPU, Qwen's weights and pictures."""
    line = re.sub(r"lab/recipes/paper/(\w+\.yaml)", rf"{ROOT}/lab/recipes/tiny/\1", line.partition(" #")[0])
    for of, by in (
        ("--scale paper", "--scale tiny"),
        ("--recipe paper", "--recipe tiny"),
        ("--workers 8", "--workers 2"),
    ):
        line = line.replace(of, by)
    return re.sub(r" --device cuda| --qwen \S+", "", line)


def write_copies(place: Path) -> None:
    """Small synthetic copies of ZeroEGGS, Motorica and BEAT2 in their published layouts."""
    for number in (1, 2, 3, 4, 5, 67):
        style = "Speech" if number == 67 else "Neutral"
        path = place / f"Zeggs_data/clean/{number:03}_{style}_{number % 3}_x_1_0.bvh"
        write_motion(path, renamed(gesture(4.5 + number % 4 / 2, 60.0), motorica_names()))
        write_wav(path.with_suffix(".wav"), speech(4.5 + number % 4 / 2, 16_000), rate=16_000)
    dances = [name for name in MOTORICA_TEST if "misc" not in name and "_mLH_" in name or "_mKR_" in name]
    for number in range(4):
        dances.append(f"kthstreet_gPO_sFM_cAll_d0{number + 1}_mPO_ch02_song_00{number}")
    for number, name in enumerate(dances):
        seconds = 4.5 + number % 4 / 2
        if number < len(dances) - 2:
            motion = renamed(gesture(seconds, 120.0), motorica_names())
            write_motion(place / f"motorica_dance_dataset/bvh/{name}.bvh", motion)
        else:  # as Listen, Denoise, Action! publishes them
            motion = renamed(gesture(seconds, 30.0, fingers=0.0), motorica_names())
            write_lda(place / f"motorica_dance_dataset/motorica_dance/{name}.expmap_30fps.pkl", motion)
        path = place / f"motorica_dance_dataset/wav/{name}.wav"
        path.parent.mkdir(exist_ok=True)
        write_wav(path, clicks(round(seconds * 30), 0.5))
    beat2 = place / "BEAT2/beat_english_v2.0.0"
    names = [f"2_scott_0_{number}_{number}" for number in range(1, 9)]
    for number, name in enumerate(names):
        write_beat2(beat2, name, 8.0 + number % 3 / 2)
    rows = [f"{name},{'test' if number >= 6 else 'train'}" for number, name in enumerate(names)]
    (beat2 / "train_test_split.csv").write_text("\n".join(["id,type", *rows]) + "\n")


@pytest.mark.slow
def test_the_page_runs_from_raw_folders_to_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command of the page in its order, but for those of `NOT_RUN`; the tables must be there at the end."""
    write_copies(tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in commands():
        words = shlex.split(small(line))[1:]
        if " ".join(words[:2]) in NOT_RUN:
            continue
        if words[0] == "bundle":
            for part in ("codec", "tokenizer"):
                shutil.copytree(f"runs/{part}", f"runs/main/{part}")
            shutil.copytree("runs/stage2", "runs/main/generator")
        found = [sorted(glob.glob(word)) if "*" in word else [word] for word in words]
        assert main([name for names in found for name in names]) == 0, line
    tables = Path("runs/tables/tiny")
    for name in ("main", "retrieval", "tokenizer-ablation", "dataset-composition", "alignment", "beat2", "latency"):
        text = (tables / f"{name}.md").read_text()
        assert "Made by `echoavatar reproduce" in text
    assert "kthstreet_gPO_sFM_cAll_d04_mPO_ch02_song_003" in Corpus("sets/motorica").names("train")  # of a pickle
    held_out = Corpus("sets/all").names("test", has_mirrored=False)
    assert {"067_Speech_1_x_1_0", "kthstreet_gKR_sFM_cAll_d01_mKR_ch01_chargedcableupyour_001"} <= set(held_out)
    assert f"{len(held_out)} test clips" in (tables / "main.md").read_text() or len(held_out) > 3
    study = read_study(tables / "user-study/study.yaml")
    assert {system.group for system in study.systems} >= {"Dataset Composition", "RL Strategy, DPO"}
