import subprocess
import sys

import pytest

from echoavatar.cli import COMMANDS, SEPARATE, main


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_script_knows_the_commands_and_their_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab")
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in COMMANDS.keys() - SEPARATE.keys())
    assert "--upper-body" in script
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_without_shtab_it_says_how(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 1
    assert "echoavatar[completion]" in capsys.readouterr().err
