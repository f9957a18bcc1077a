"""`echoavatar studio` as people start it."""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from studio.tests import canned

from echoavatar.cli import main
from echoavatar_studio.making import Maker


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["--certificate", "a.pem"], "both or neither"),
        (["--tls-cert", "pyproject.toml", "--tls-key", "README.md"], "certificate pyproject.toml with key README.md"),
        (["--store", "mysql://x/y"], "SQLite or PostgreSQL"),
        (["--study", "none.yaml"], "none.yaml cannot be read"),
        (["export", "--id", "none"], "there is no study none"),
        (["restore", "-o", "none.zip"], "not a backup"),
    ],
)
def test_mistakes_are_one_line(words, remedy, tmp_path, capsys):
    assert main(["studio", "--folder", str(tmp_path / "studio"), "--port", "0", *words]) == 1
    told = capsys.readouterr().err
    assert remedy in told
    assert told.count("\n") == 1


def test_from_study_yaml_to_files(tmp_path: Path, monkeypatch):
    """A study is made and served; the password is told; then export, backup and restore."""
    canned.library(tmp_path / "place", sounds=2)
    (tmp_path / "place" / "study.yaml").write_text(canned.pairwise_text())
    folder = str(tmp_path / "studio")
    words = ["studio", "--folder", folder, "--study", str(tmp_path / "place" / "study.yaml"), "--port", "0"]
    with subprocess.Popen(
        [sys.executable, "-m", "echoavatar", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert re.match(r"Canned pairs: study [0-9a-f]{24}\n", process.stdout.readline())
        address = re.match(r"the studio is at (\S+)", process.stdout.readline())
        assert address
        assert re.match(r"owner: owner   password: \S{16} ", process.stdout.readline())
        with urllib.request.urlopen(f"{address[1]}api/scene", timeout=30) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    monkeypatch.setenv("ECHOAVATAR_STUDIO_PASSWORD", "a good password")
    assert main(["studio", "owner", "--folder", folder, "--name", "anna"]) == 0
    assert main(["studio", "export", "--folder", folder, "-o", str(tmp_path / "out")]) == 0
    assert "table.tex" in os.listdir(tmp_path / "out")
    backup = str(tmp_path / "b.zip")
    assert main(["studio", "backup", "--folder", folder, "-o", backup]) == 0
    assert main(["studio", "restore", "--folder", str(tmp_path / "again"), "-o", backup]) == 0
    assert main(["studio", "export", "--folder", str(tmp_path / "again"), "-o", str(tmp_path / "out2")]) == 0
    same = [(tmp_path / name / "judgements.csv").read_text() for name in ("out", "out2")]
    assert same[0] == same[1]


def test_backup_and_restore_are_one_command_each_on_either_store(either: Maker, url: str, library, tmp_path: Path):
    study = canned.make_pairwise(either, library)
    here = ["--folder", str(either.media.parent), "--store", either.store.url.render_as_string(False)]
    there = ["--folder", str(tmp_path / "there"), "--store", url]
    assert main(["studio", "backup", *here, "-o", str(tmp_path / "b.zip")]) == 0
    assert main(["studio", "restore", *there, "-o", str(tmp_path / "b.zip")]) == 0
    for place, name in ((here, "one"), (there, "two")):
        assert main(["studio", "export", *place, "--id", study, "-o", str(tmp_path / name)]) == 0
    assert (tmp_path / "one/judgements.csv").read_bytes() == (tmp_path / "two/judgements.csv").read_bytes()
    assert {path.name for path in (tmp_path / "there/media").rglob("*")} == {
        path.name for path in either.media.rglob("*")
    }
