from lab.tests.corpora.capture.people import library

from echoavatar.cli import main
from echoavatar_lab.corpora.capture.library import open_library


def test_a_library_is_shown_and_copied_with_its_licences(tmp_path, capsys):
    library().save(tmp_path / "people.npz")
    assert main(["data", "capture", str(tmp_path / "people.npz"), "-o", str(tmp_path / "copy.npz"), "--clips"]) == 0
    out = capsys.readouterr().out
    row = next(line.split() for line in out.splitlines() if line.startswith("speech"))
    assert row[1:3] == ["talk", "20.0"]
    assert 3 < float(row[10]) < 12  # hip sway in centimetres: 8 cm to and fro
    assert "talks: CC0" in out
    assert len(open_library(tmp_path / "copy.npz").clips) == 3


def test_a_folder_without_captured_people_says_what_to_do(tmp_path, capsys):
    assert main(["data", "capture", str(tmp_path)]) == 1
    assert "standing" in capsys.readouterr().err
