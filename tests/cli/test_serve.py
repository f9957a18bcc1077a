"""`echoavatar serve` as people start it."""

import logging
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from echoavatar.cli import main


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["--ahead", "9"], "between 0.3 and 3.5"),
        (["--certificate", "a.pem"], "both or neither"),
        (["--certificate", "a.pem", "--key", "b.pem"], "file a.pem does not exist"),
        (["--tls-cert", "pyproject.toml", "--tls-key", "README.md"], "certificate pyproject.toml with key README.md"),
        (["--model", "nobody"], "nobody"),
        (["--device", "gpu"], "say cpu, cuda"),
        (["--without", "toes"], "no stage 'toes'"),
    ],
)
def test_errors_are_one_line(words: list[str], remedy: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--port", "0", *words]) == 1
    told = capsys.readouterr().err
    assert remedy in told
    assert told.count("\n") == 1


def test_a_server_serves_its_page_and_stops_in_good_order(tiny_bundle: Path) -> None:
    """On every address of the machine a token is made up, and the printed address bears it."""
    command = [sys.executable, "-m", "echoavatar", "serve", "--port", "0", "--host", "0.0.0.0"]
    with subprocess.Popen(
        [*command, "--model", str(tiny_bundle), "--seats", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"ECHOAVATAR_TOKEN": ""},
    ) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[3]
            assert "?token=" in address
            page = address.replace("0.0.0.0", "127.0.0.1")
            with urllib.request.urlopen(page, timeout=10) as answer:
                assert answer.status == 200
            process.send_signal(signal.SIGTERM)
            assert process.wait(15) in (0, -signal.SIGTERM)
        finally:
            process.kill()


@pytest.mark.parametrize("place", ["environment", "command line", "made up", "made up, none is wanted"])
def test_the_operators_own_token_is_never_shown(
    place: str,
    tiny_bundle: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A token that the server makes up is shown, since nobody knows it else."""
    monkeypatch.setenv("ECHOAVATAR_TOKEN", "very-secret" if place == "environment" else "")
    known: list[str] = []

    def announce(app: Any, *, on_ready: Callable[[str], None], **_: object) -> None:
        known.append(app.state.manager.settings.token)
        on_ready("http://0.0.0.0:1")

    monkeypatch.setattr("echoavatar.server.serve", announce)
    words = {"command line": ["--token", "very-secret"], "made up, none is wanted": ["--token", ""]}.get(place, [])
    with caplog.at_level(logging.DEBUG):
        assert main(["serve", "--host", "0.0.0.0", "--model", str(tiny_bundle), *words]) == 0
    shown = capfd.readouterr()
    told = shown.out + shown.err + caplog.text
    if place.startswith("made up"):
        assert f"?token={known[0]}" in shown.out
        assert len(known[0]) >= 22
    else:
        assert known == ["very-secret"]
        assert "very-secret" not in told


def test_the_unity_sink_wants_an_address_and_an_imported_bundle_and_no_other_sink(tiny_bundle, capsys):
    serve = ["serve", "--model", str(tiny_bundle)]
    for words, complaint in (
        (["--sink", "unity://"], "HOST:PORT"),
        (["--sink", "unity://127.0.0.1", "--sink", "vmc://127.0.0.1"], "excludes other sinks"),
        (["--sink", "unity://127.0.0.1"], "not made for that Unity project's rig"),
        (["--sink", "unity-legacy"], "no known kind"),
        (["--sink", "vmc://127.0.0.1?rate=0"], "between 1 and 240"),
    ):
        assert main([*serve, *words]) == 1
        assert complaint in capsys.readouterr().err
