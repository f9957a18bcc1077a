"""Several files of one command: one that fails does not stop the others."""

import errno
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from echoavatar.cli import main
from echoavatar.cli.batch import STDIN, Batch, outputs, readable_sound
from echoavatar.errors import EchoAvatarError


def table(out: str) -> dict[str, tuple[str, str]]:
    """Result and cause of each file, from the table at the end."""
    lines = out.splitlines()
    start = next(number for number, line in enumerate(lines) if line.split() == ["file", "result", "cause"])
    rows = (line.split(None, 2) for line in lines[start + 1 : -1])
    return {Path(row[0]).name: (row[1], row[2] if len(row) > 2 else "") for row in rows}


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_one_bad_sound_of_three_stops_no_other(
    tmp_path: Path, tiny_bundle: Path, voice: np.ndarray, bad: int, capsys: pytest.CaptureFixture[str]
) -> None:
    sounds = [tmp_path / f"{name}.wav" for name in "abc"]
    for number, path in enumerate(sounds):
        if number == bad:
            path.write_text('{"error": "no credit"}')
        else:
            soundfile.write(path, voice[:9_600], 24_000)
    out = tmp_path / "out"
    words = ["animate", *map(str, sounds), "-o", str(out), "--format", ".npz", "--model", str(tiny_bundle)]
    assert main(words) == 1
    told = capsys.readouterr()
    made = {f"{path.stem}.npz" for number, path in enumerate(sounds) if number != bad}
    assert {path.name for path in out.iterdir()} == made
    rows = table(told.out)
    assert set(rows) == {path.name for path in sounds}
    assert rows[sounds[bad].name][0] == "failed"
    assert "is not a sound file but text" in rows[sounds[bad].name][1]
    assert sum(row[0].endswith(".npz") for row in rows.values()) == 2
    assert told.out.splitlines()[-1] == "1 of 3 failed"
    assert told.err.count("no credit") == 1


def test_a_missing_file_and_a_folder_are_failures_like_others(
    tmp_path: Path, tiny_bundle: Path, voice: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    soundfile.write(tmp_path / "a.wav", voice[:9_600], 24_000)
    (tmp_path / "folder").mkdir()
    names = ["a.wav", "none.wav", "folder"]
    words = ["animate", *(str(tmp_path / name) for name in names), "-o", str(tmp_path / "out")]
    assert main([*words, "--format", "npz", "--model", str(tiny_bundle)]) == 1
    rows = table(capsys.readouterr().out)
    assert "does not exist" in rows["none.wav"][1]
    assert "is a folder" in rows["folder"][1]


def test_recordings_go_into_a_folder_and_a_bad_one_stops_no_other(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(recording, tmp_path / "second.npz")
    (tmp_path / "bad.npz").write_text("no")
    words = ["export", str(recording), str(tmp_path / "bad.npz"), str(tmp_path / "second.npz")]
    assert main([*words, "-o", str(tmp_path / "out"), "--format", "bvh"]) == 1
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{recording.stem}.bvh", "second.bvh"}
    assert table(capsys.readouterr().out)["bad.npz"][0] == "failed"
    assert main(["export", str(recording), str(recording), "-o", str(tmp_path / "out")]) == 1
    assert "two recordings are called" in capsys.readouterr().err
    assert main(["export", str(recording), words[-1], "-o", str(tmp_path / "a.bvh")]) == 1
    assert "several recordings need a folder" in capsys.readouterr().err


def test_a_file_of_the_folder_is_not_written_over_by_its_own_output(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(recording, tmp_path / "second.npz")
    before = recording.read_bytes()
    words = ["export", str(recording), str(tmp_path / "second.npz"), "-o", str(recording.parent), "--format", "npz"]
    assert main(words) == 1
    assert "is the recording itself" in capsys.readouterr().err
    assert recording.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("export {other} --rig {read} -o {read}", "rig"),
        ("export {other} --rig r.glb --map {read} -o {read}", "map"),
        ("animate {other} --rig {read} -o {read}", "rig"),
        ("animate {other} --words {read} -o {read}", "words"),
        ("rig {read} -o {read}", "character"),
        ("refine-fingers {read} {read}", "recording"),
        ("say {read} -o {read}", "sound"),
    ],
)
def test_nothing_that_is_read_is_written_over(
    words: str, kind: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read = tmp_path / "a.bvh"
    read.write_text("kept")
    assert main(words.format(read=read, other=recording).split()) == 1
    assert f"a.bvh is the {kind} itself; choose another name" in capsys.readouterr().err
    assert read.read_text() == "kept"


def test_a_file_without_a_format_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(EchoAvatarError, match="is a file whose suffix is no format's"):
        outputs([tmp_path / "a.wav"], tmp_path / "out", ".glb", known=[".glb"], kind="sound")


def test_a_closed_standard_input_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)  # as Python has it after `<&-`
    with pytest.raises(EchoAvatarError, match="standard input .* is closed"):
        outputs([STDIN], tmp_path / "a.glb", ".glb", known=[".glb"], kind="sound")


def test_a_link_that_leads_to_itself_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop.bvh").symlink_to(tmp_path / "loop.bvh")
    assert main(["export", str(tmp_path / "loop.bvh"), "-o", str(tmp_path / "a.npz")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "loop.bvh" in told


def test_what_is_no_fault_of_a_file_ends_the_batch() -> None:
    batch = Batch(2)
    with pytest.raises(ZeroDivisionError), batch.each("a"):
        raise ZeroDivisionError
    with batch.each("b"):
        raise OSError(28, "No space left on device")
    assert batch.end() == 1


def test_the_error_of_a_single_file_passes_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    batch = Batch(1)
    with pytest.raises(EchoAvatarError), batch.each("a"):
        raise EchoAvatarError("broken; mend it")
    assert capsys.readouterr() == ("", "")


def test_files_do_not_go_to_standard_output(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="-o -: files do not go to standard output; name a file"):
        outputs([tmp_path / "a.wav"], STDIN, ".glb", known=(".glb",), kind="sound")


def test_a_full_disk_is_not_taken_for_the_output_while_standard_input_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=SimpleNamespace(read=_full)))
    with pytest.raises(EchoAvatarError, match=r"cannot write .*stdin \(No space left on device"), readable_sound(STDIN):
        pass


def _full(count: int) -> bytes:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
