from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import AudioError
from echoavatar.models.audio import write_wav
from echoavatar.models.audio.recorded_files import decoded, recorded_files

HEAD = "path,seconds,kind,speaker_or_artist,title,language_or_genre,split\n"


def folder(path: Path, rows: str) -> Path:
    for name in ("a.wav", "b.wav"):
        write_wav(path / name, np.linspace(-0.5, 0.5, 480).astype(np.float32))
    (path / "manifest.csv").write_text(HEAD + rows)
    return path


def test_a_manifest_says_who_is_heard_and_what_is_held_out(tmp_path: Path) -> None:
    rows = "b.wav,2.5,music,Band,Song,waltz [excerpt],test\na.wav,1,speech,Ann (f),Talk,English,train\n"
    speech, music = recorded_files(folder(tmp_path, rows))
    assert (speech.kind, speech.voice, speech.split) == ("speech", "Ann (f)", "train")
    assert (music.title, music.style, music.seconds) == ("Song", "waltz", 2.5)
    assert recorded_files(tmp_path, "train") == (speech,)
    assert recorded_files(tmp_path, "test") == (music,)


@pytest.mark.parametrize("row", ["a.wav,1,birdsong,,,,train", "a.wav,1,speech,,,,", "c.wav,1,speech,,,,train"])
def test_a_damaged_line_is_named(tmp_path: Path, row: str) -> None:
    with pytest.raises(AudioError, match="line 2"):
        recorded_files(folder(tmp_path, row))


def test_no_file_outside_the_folder_is_read(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_wav(tmp_path / "out.wav", np.zeros(480, np.float32))
    with pytest.raises(AudioError, match="no file of this folder"):
        recorded_files(folder(tmp_path / "in", "../out.wav,1,speech,,,,train"))


def test_sound_is_decoded_once(tmp_path: Path, own_cache: Path) -> None:
    path = folder(tmp_path, "") / "a.wav"
    first = decoded(path)
    assert abs(int(first[0]) + 16_384) <= 1
    kept = list((own_cache / "echoavatar" / "sound").glob("*.npy"))
    assert len(kept) == 1
    assert np.array_equal(np.load(kept[0]), first)
    write_wav(path, np.zeros(960, np.float32))
    assert len(decoded(path)) == 960


def test_dev_is_test_where_nothing_is_marked_dev(tmp_path: Path) -> None:
    held_out = "b.wav,1,music,Band,Song,waltz,test\n"
    folder(tmp_path, held_out + "a.wav,1,speech,Ann,Talk,English,train\n")
    assert recorded_files(tmp_path, "dev") == recorded_files(tmp_path, "test")
    folder(tmp_path, held_out + "a.wav,1,speech,Ann,Talk,English,dev\n")
    assert [file.voice for file in recorded_files(tmp_path, "dev")] == ["Ann"]
