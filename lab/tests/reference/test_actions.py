"""The table of actions is data in somebody's script: read, never run."""

import json

import numpy as np
import pytest
from scripts.synthetic_release import ACTIONS

from echoavatar.engine.pipeline import ActionLibrary
from echoavatar.errors import CheckpointError
from echoavatar_lab.reference.actions import find_table, library, read_table


def test_the_script_beside_the_statistics_is_found_and_not_run(download):
    path = find_table(download / "stats")
    assert path is not None
    table = read_table(path)  # the script ends the program when it is run
    assert table == ACTIONS | {"stand": [7, 9, 495 - 512 * 6]}
    assert find_table(download / "ckpts/face") is None


def test_sets_hold_as_a_whole_over_both_segments(tmp_path):
    actions = library({"Raise up left-hand": [5, 2], "stand": [7, 495 - 3072]}, 512, origin="x")
    actions.save(tmp_path)
    again = ActionLibrary.load(tmp_path, 1024)
    assert list(again) == ["raise_up_left_hand", "stand"]
    stand = again.find("stand")
    for elapsed in (0, 7, 14):
        assert np.flatnonzero(stand.members(elapsed, 15, 1024)).tolist() == [7, 512 + 495]
    assert stand.seconds == pytest.approx(4.0)
    assert stand.length(10.0) > 30
    with pytest.raises(CheckpointError, match="another tokenizer"):
        ActionLibrary.load(tmp_path, 512)


def test_a_table_as_json_is_read_and_others_are_refused(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"idle": [1, 2]}))
    assert read_table(tmp_path / "a.json") == {"idle": [1, 2]}
    for name, text in (("b.json", '{"idle": "x"}'), ("c.py", "x = {'a': [open]}"), ("d.py", "x = (")):
        (tmp_path / name).write_text(text)
        with pytest.raises(CheckpointError, match="no table of actions"):
            read_table(tmp_path / name)
    with pytest.raises(CheckpointError, match="cannot be read"):
        read_table(tmp_path / "none.py")
    with pytest.raises(CheckpointError, match="beyond 512"):
        library({"idle": [600 + 512]}, 512, origin="x")


@pytest.mark.parametrize(("name", "text"), [("a.json", "[" * 100_000), ("a.py", "x = {'a': [" + "1+" * 50_000 + "1]}")])
def test_a_table_that_is_nested_too_deep_is_none(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(CheckpointError, match="no table of actions"):
        read_table(tmp_path / name)
