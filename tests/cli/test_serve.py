"""`echoavatar serve` as people start it."""

import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from echoavatar.cli import main


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["--ahead", "9"], "between 0.3 and 3.5"),
        (["--certificate", "a.pem"], "both or neither"),
        (["--certificate", "a.pem", "--key", "b.pem"], "file a.pem does not exist"),
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
