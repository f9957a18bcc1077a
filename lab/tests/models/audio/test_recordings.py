from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import AudioError
from echoavatar.models.audio import write_wav
from echoavatar_lab.evaluation.takes import read_sounds
from echoavatar_lab.models.audio.recordings import (
    DEV,
    MANIFEST,
    TEST,
    TRAIN,
    AudioGroup,
    AudioPool,
    RecordedFile,
    decoded,
    read_groups,
    recorded_files,
    split_of,
    to_int16,
)

RECORDINGS = Path(__file__).parents[5] / "shared" / "data" / "audio_permissive" / "corpus"
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


def test_dev_is_test_where_nothing_is_marked_dev(tmp_path: Path) -> None:
    held_out = "b.wav,1,music,Band,Song,waltz,test\n"
    folder(tmp_path, held_out + "a.wav,1,speech,Ann,Talk,English,train\n")
    assert recorded_files(tmp_path, "dev") == recorded_files(tmp_path, "test")
    folder(tmp_path, held_out + "a.wav,1,speech,Ann,Talk,English,dev\n")
    assert [file.voice for file in recorded_files(tmp_path, "dev")] == ["Ann"]


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("a.wav,1,speech,Ann,One,English,train\nb.wav,1,speech, ann,Two,English,test\n", "voice"),
        ("a.wav,1,music,Band,One,waltz,train\nb.wav,1,music,Band,Two,waltz,dev\n", "voice"),
        ("a.wav,1,music,Band,Song,waltz,dev\nb.wav,1,music,Other,song,waltz,test\n", "piece"),
    ],
)
def test_a_voice_or_a_piece_in_two_splits_is_refused(tmp_path: Path, rows: str, told: str) -> None:
    with pytest.raises(AudioError, match=f"the {told} .* is in .* and in .*give all of its files one split"):
        recorded_files(folder(tmp_path, rows), "train")
    with pytest.raises(AudioError, match=f"the {told} "):
        read_sounds(tmp_path, 1, 1)


def test_two_people_may_read_one_text_and_nameless_files_any_split(tmp_path: Path) -> None:
    rows = "a.wav,1,speech,Ann,Text,English,train\nb.wav,1,speech,Bob,Text,English,test\n"
    assert len(recorded_files(folder(tmp_path, rows))) == 2
    assert len(recorded_files(folder(tmp_path, rows.replace("Ann", "").replace("Bob", "")))) == 2


def in_two_splits(pairs: Iterable[tuple[str, str]]) -> set[str]:
    splits = defaultdict(set)
    for name, split in pairs:
        splits[name.casefold()].add(split)
    return {name for name, found in splits.items() if len(found) > 1}


def test_nobody_is_listed_twice() -> None:
    assert len(TEST | DEV | TRAIN) == len(TEST) + len(DEV) + len(TRAIN)


def test_unknown_voices_stay_where_their_manifest_has_them() -> None:
    assert [split_of("somebody", listed) for listed in ("train", "dev", "test")] == ["train", "dev", "test"]
    assert split_of("Komiku", "train") == "test"


@pytest.fixture(scope="module")
def files() -> tuple[RecordedFile, ...]:
    if not (RECORDINGS / MANIFEST).is_file():
        pytest.skip(f"{RECORDINGS} is not there: the recordings are no part of the repository")
    return recorded_files(RECORDINGS)


def test_no_speaker_artist_or_piece_is_in_two_splits(files: tuple[RecordedFile, ...]) -> None:
    assert not in_two_splits((file.voice, file.split) for file in files)
    assert not in_two_splits((file.title, file.split) for file in files)
    assert not in_two_splits((file.path.stem, file.split) for file in files)


def test_twelve_voices_and_twelve_tracks_are_held_back(files: tuple[RecordedFile, ...]) -> None:
    test = [file for file in files if file.split == "test"]
    assert len({file.voice for file in test if file.kind == "speech"}) == 12
    assert sum(file.kind == "music" for file in test) == 12
    assert {file.voice for file in test} == TEST


def test_sound_is_decoded_once(tmp_path: Path, own_cache: Path) -> None:
    path = folder(tmp_path, "") / "a.wav"
    first = decoded(path)
    assert abs(int(first[0]) + 16_384) <= 1
    kept = list((own_cache / "echoavatar" / "sound").glob("*.npy"))
    assert len(kept) == 1
    assert np.array_equal(np.load(kept[0]), first)
    write_wav(path, np.zeros(960, np.float32))
    assert len(decoded(path)) == 960


pytestmark = pytest.mark.usefixtures("own_cache")


def group(name: str, value: float, weight: float, samples: int = 24_000) -> AudioGroup:
    return AudioGroup(name, (to_int16(np.full(samples, value, np.float32)),), weight)


def test_groups_are_drawn_by_weight():
    pool = AudioPool([group("a", 0.25, 3), group("b", -0.5, 1)])
    rng = np.random.default_rng(0)
    drawn = np.array([pool.draw(rng, 100)[0] for _ in range(400)])
    assert set(np.unique(drawn)) == {0.25, -0.5}
    assert 0.68 < np.mean(drawn == 0.25) < 0.82
    assert pool.seconds == {"a": 1.0, "b": 1.0}


def test_short_recordings_are_followed_by_silence():
    piece = AudioPool([group("a", 0.5, 1, samples=10)]).draw(np.random.default_rng(0), 30)
    assert piece.tolist() == [0.5] * 10 + [0.0] * 20


def test_a_folder_gives_a_group_of_speech_and_one_of_music(tmp_path):
    sound = np.linspace(-0.5, 0.5, 2_400).astype(np.float32)
    write_wav(tmp_path / "a.wav", sound)
    write_wav(tmp_path / "music.wav", 0.5 * sound)
    speech, music = read_groups(tmp_path)
    assert (speech.name, music.name) == (f"{tmp_path.name}: speech", f"{tmp_path.name}: music")
    for group_, wanted in ((speech, sound), (music, 0.5 * sound)):
        np.testing.assert_allclose(group_.recordings[0] / 32_768, wanted, atol=1e-4)


def test_no_sound_at_all_is_refused(tmp_path):
    with pytest.raises(AudioError, match="every folder given is empty"):
        AudioPool([AudioGroup("nothing", ())])
    with pytest.raises(AudioError, match="no sound"):
        read_groups(tmp_path)
