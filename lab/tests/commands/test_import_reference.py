"""`echoavatar import reference`: dry run, conversion, and one line for each thing that is wrong."""

import pytest
from scripts.synthetic_release import make

from echoavatar.cli import main


@pytest.fixture(scope="module")
def download(tmp_path_factory):
    return make(tmp_path_factory.mktemp("release"), "small")


def words(download, output, *more: str) -> list[str]:
    folders = ["--ckpts", str(download / "ckpts"), "--stats", str(download / "stats")]
    return ["import", "reference", *folders, "--codec", str(download / "encodec"), "-o", str(output), *more]


def test_a_dry_run_prints_every_tensor_and_writes_nothing(download, tmp_path, capsys):
    assert main(words(download, tmp_path / "out", "--dry-run")) == 0
    said = capsys.readouterr().out.splitlines()
    assert "net_65000.pth: input_liner.weight [16, 117] -> tokenizer: parts.lower.input_liner.weight" in said
    assert said[-1].endswith("tensors and tables fit, 3 actions; nothing was written")
    assert not (tmp_path / "out").exists()


def test_it_converts_and_says_whose_it_is(download, tmp_path, capsys):
    assert main(words(download, tmp_path / "out")) == 0
    assert "without a licence" in capsys.readouterr().out
    assert main(["bundle", str(tmp_path / "out")]) == 0
    assert "88 joints" in capsys.readouterr().out
    assert main(words(download, tmp_path / "out")) == 1
    assert "not empty" in capsys.readouterr().err


def test_problems_are_listed_one_a_line(download, tmp_path, capsys):
    """One that several parts share is told once."""
    broken = words(download / "ckpts/face", tmp_path / "out")
    assert main(broken) == 1
    said = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("problem: ") for line in said) == 4
    assert said[-1] == "echoavatar: 4 problems, listed above; nothing was written"
    assert not (tmp_path / "out").exists()
