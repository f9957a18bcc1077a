"""Nobody, and no piece, is in two splits of the recordings."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest

from echoavatar.models.audio.recorded_files import MANIFEST, RecordedFile, recorded_files
from echoavatar.models.audio.recorded_splits import DEV, TEST, TRAIN, split_of

RECORDINGS = Path(__file__).parents[4] / "shared" / "data" / "audio_permissive" / "corpus"


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
