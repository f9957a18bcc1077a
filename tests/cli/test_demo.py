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
    assert "choose another -o" in capsys.readouterr().err
