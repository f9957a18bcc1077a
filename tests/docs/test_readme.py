"""The README is true."""

import re
from pathlib import Path

import numpy as np
import pytest
import soundfile

import echoavatar
from echoavatar.cli import COMMANDS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_the_python_example_runs_and_prints_what_it_says(capsys: pytest.CaptureFixture[str]) -> None:
    _, code = re.findall(r"```python\n(.*?)```", README, re.S)
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "(4, 52, 4) (4, 3)"
    assert len(printed) == 15  # of two seconds


def test_the_three_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    soundfile.write("talk.wav", np.zeros(24_000), 24_000)
    code = re.findall(r"```python\n(.*?)```", README, re.S)[0]
    exec(compile(code, "README.md", "exec"), {})
    assert (tmp_path / "talk.glb").read_bytes()[:4] == b"glTF"


def test_it_opens_with_one_line_to_install_and_two_commands_for_a_clone() -> None:
    install, clone = re.findall(r"```sh\n(.*?)```", README, re.S)[:2]
    assert install == "pip install echoavatar\n"  # which works wherever PyPI does
    assert "--extra-index-url" not in README
    assert [line.split("#")[0].strip() for line in clone.strip().splitlines()] == ["make demo", "make test"]


def test_every_command_is_named_and_every_link_leads_somewhere() -> None:
    assert all(re.search(rf"\b{command}\b", README) for command in COMMANDS)
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_public_names_are_few_and_all_there() -> None:
    assert len(echoavatar.__all__) <= 10
    for name in echoavatar.__all__:
        assert getattr(echoavatar, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        echoavatar.nonsense  # noqa: B018
