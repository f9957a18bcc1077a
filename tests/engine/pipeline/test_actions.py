from pathlib import Path

import pytest

from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.timing import ChunkSize

BOW = Action("bow", (5, 6, 7, 5, 1, 2), (1, 2), "a bow")


def test_a_library_comes_back_as_it_was_saved(tmp_path: Path) -> None:
    library = ActionLibrary().with_action(BOW)
    library.save(tmp_path)
    assert ActionLibrary.load(tmp_path, 8) == library
    assert ActionLibrary.load(tmp_path / "none", 8) == ActionLibrary()


def test_names_are_forgiving_and_unknown_ones_answer_with_the_list() -> None:
    library = ActionLibrary({"raise_left_hand": BOW, "bow": BOW})
    assert library.find("Raise left-hand") is BOW
    with pytest.raises(EchoAvatarError, match="there are: raise_left_hand, bow"):
        library.find("jump")


def test_codes_of_another_tokenizer_and_damaged_files_are_named(tmp_path: Path) -> None:
    ActionLibrary({"bow": BOW}).save(tmp_path)
    with pytest.raises(CheckpointError, match="'bow' was made for another tokenizer"):
        ActionLibrary.load(tmp_path, 4)
    older = (tmp_path / "actions.json").read_text().replace('"version": 2', '"version": 1')
    (tmp_path / "actions.json").write_text(older)
    with pytest.raises(CheckpointError, match="version 1, read is 2.*make it again"):
        ActionLibrary.load(tmp_path, 8)
    (tmp_path / "actions.json").write_text("[1, 2")
    with pytest.raises(CheckpointError, match="not a library of actions"):
        ActionLibrary.load(tmp_path, 8)


def test_the_set_passes_along_the_clip() -> None:
    """Three chunks with codes 5 6 | 7 5 | 1 2: the set reaches one chunk each way."""
    sets = [set(BOW.members(chunk, 3, 8).nonzero()[0].tolist()) for chunk in range(3)]
    assert sets == [{5, 6, 7}, {1, 2, 5, 6, 7}, {1, 2, 5, 7}]


def test_a_library_means_the_same_to_bundles_of_any_chunk(tmp_path: Path) -> None:
    """The part that repeats begins and ends at the same seconds."""
    ActionLibrary({"bow": BOW}).save(tmp_path)
    half = ActionLibrary.load(tmp_path, 8, ChunkSize(1))["bow"]
    assert (half.chunks, half.seconds, half.hold) == (6, BOW.seconds, (2 * BOW.hold[0], 2 * BOW.hold[1]))
    assert ActionLibrary.load(tmp_path, 8)["bow"] == BOW


def test_nobody_holds_a_pose_for_more_than_a_minute() -> None:
    """225 chunks of 0.27 s."""
    assert [BOW.length(seconds) for seconds in (50.0, 1e9)] == [188, 225]


def test_a_bundle_of_longer_chunks_counts_in_them(tmp_path: Path) -> None:
    """Six codes are two chunks of three tokens, 0.8 s; two seconds are five of them."""
    ActionLibrary({"bow": BOW}).save(tmp_path)
    bow = ActionLibrary.load(tmp_path, 8, ChunkSize(3))["bow"]
    assert (bow.chunks, bow.seconds, bow.length(2.0)) == (2, pytest.approx(0.8), 5)
    assert bow.members(0, 2, 8).nonzero()[0].tolist() == [1, 2, 5, 6, 7]
