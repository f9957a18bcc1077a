import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from echoavatar.cli import main


def test_the_demo_writes_a_page_and_models_and_opens_nothing(tiny_bundle: Path, tmp_path: Path) -> None:
    words = ["demo", "-o", str(tmp_path), "--model", str(tiny_bundle), "--no-video", "--no-browser"]
    assert main(words) == 0
    page = (tmp_path / "index.html").read_text()
    assert page.count("data:audio/ogg;base64,") == 2
    assert (tmp_path / "speech.glb").read_bytes()[:4] == b"glTF"
    assert (tmp_path / "music.glb").exists()
    assert "http://" not in page.split("<script")[0]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["demo", "-o", str(tmp_path / "file" / "demo"), "--no-browser"]) == 1
    assert "choose another place" in capsys.readouterr().err


def test_without_a_folder_a_live_page_is_served_until_stopped(tiny_bundle: Path) -> None:
    words = ["demo", "--no-browser", "--port", "0", "--model", str(tiny_bundle)]
    with subprocess.Popen([sys.executable, "-m", "echoavatar", *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = process.stdout.readline()
        address = re.search(r"http://127\.0\.0\.1:\d+/", told)
        assert address, told
        with urllib.request.urlopen(address[0]) as answer:
            assert b"<script" in answer.read()
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) in (0, -signal.SIGTERM)
