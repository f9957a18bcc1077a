"""`echoavatar pull` prints what came, or one line about what to do."""

from pathlib import Path

from echoavatar import hub
from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError


def test_pull_reports_files_and_checks(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(hub, "pull", lambda name, output, **_: hub.Pulled(Path(output), 3, 2, "c0ffee"))
    assert main(["pull", "owner/name", "-o", str(tmp_path), "--only", "ckpts/*"]) == 0
    assert "3 files, 2 checked against the hub's sha256, commit c0ffee" in capsys.readouterr().out


def test_a_failure_is_one_line(monkeypatch, capsys):
    def fail(name, output, **_):
        raise EchoAvatarError("the hub cannot be reached")

    monkeypatch.setattr(hub, "pull", fail)
    assert main(["pull", "owner/name"]) == 1
    assert capsys.readouterr().err == "echoavatar: the hub cannot be reached\n"
