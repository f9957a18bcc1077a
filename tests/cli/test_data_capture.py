from pathlib import Path

import pytest
from tests.corpora.capture.conftest import captured_folder  # noqa: F401

from echoavatar.cli import main


def test_a_library_is_made_and_shown(captured_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):  # noqa: F811
    library = tmp_path / "people.npz"
    assert main(["data", "capture", str(captured_folder), "-o", str(library)]) == 0
    made = capsys.readouterr().out
    assert "standing" in made
    assert "MIT" in made
    assert main(["data", "capture", str(library), "--clips"]) == 0
    assert "ben.1" in capsys.readouterr().out
