import argparse
import re
import shutil
from pathlib import Path

import pytest
from lab.tests.evaluation.clips import clip, folder

from echoavatar.cli import main
from echoavatar_lab.commands.reproduce import TABLES, _command, add_arguments
from echoavatar_lab.tables import run


def test_the_command_offers_the_tables_there_are() -> None:
    assert tuple(run.TABLES) == TABLES


def test_the_papers_scale_asks_for_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "main", "--scale", "paper", "-o", str(tmp_path)]) == 1
    assert "--corpus" in capsys.readouterr().err


def test_a_command_is_told_without_places() -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    args = parser.parse_args(["main", "-o", "/a/b/runs", "--corpus", "/c/set", "--seed", "3"])
    assert _command(args, "main") == "echoavatar reproduce main --scale tiny -o runs --corpus set --seed 3"


def test_bad_requests_are_told_in_one_line(
    tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = folder(tmp_path / "unsplit", [clip(name, 90, split="train") for name in "abc"], is_corpus=True)
    two = folder(
        tmp_path / "split", [*(clip(name, 90) for name in "abc"), clip("d", 90, split="train")], is_corpus=True
    )
    part = shutil.copytree(tiny_bundle, tmp_path / "part")
    shutil.rmtree(part / "generator")
    for words, told in (
        (
            ["main", "--corpus", str(one)],
            r"unsplit has no split to test on \(3 train, 0 val, 0 test\).*--test-every 10",
        ),
        (["layouts", "--with", "A=made"], "layouts has no lines of other systems; --with goes with main"),
        (["main", "--with", "A=x", "--with", "A=y"], "two --with have the same name"),
        (["main", "--corpus", str(two), "--with", "A=none"], "none is not a folder"),
        (["main", "--device", "tpu"], "no device 'tpu'"),
        (["latency", "--model", str(part)], "part is not a bundle: generator missing; see `echoavatar bundle`"),
    ):
        assert main(["reproduce", *words, "-o", str(tmp_path / "out")]) == 1
        err = capsys.readouterr().err
        assert re.search(told, err), err
        assert err.splitlines()[-1].startswith("echoavatar: ")


@pytest.mark.slow
def test_the_ablation_from_nothing_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All six tokenizers and generators; the second call makes nothing and prints the same."""
    words = ["reproduce", "tokenizer-ablation", "--scale", "tiny", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    first = capsys.readouterr()
    assert "tokenizers/causal-conv" in first.err
    assert main(words) == 0
    second = capsys.readouterr()
    assert "tokenizers/causal-conv" not in second.err
    assert first.out == second.out
    for line in ("CausalConv-RVQ", "Attn (w/o dual)", "Attn (w/ bodypart)"):
        assert f"| {line} |" in second.out


@pytest.mark.slow
def test_the_trade_off_from_nothing_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both rewards, pairs, all three methods; the second call makes nothing and prints the same."""
    words = ["reproduce", "alignment", "--scale", "tiny", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    first = capsys.readouterr()
    assert "line: Ours (PPO)" in first.err
    assert main(words) == 0
    second = capsys.readouterr()
    assert "tokenizers/" not in second.err
    assert first.out == second.out
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in second.out.splitlines() if "|" in row]
    ours = [column for column, head in enumerate(rows[0]) if head.endswith("ours")]
    found = {row[0]: [row[column] for column in ours] for row in rows[2:]}
    assert list(found) == ["GT", "Ours (no RL)", "Ours (DPO)", "Ours (GRPO)", "Ours (PPO)"]
    assert len(ours) >= 7  # FID, diversity, BA_G and over chance, both rewards, KL; BA_D where a test clip is music
    assert all("-" not in cells for name, cells in found.items() if name != "GT")
