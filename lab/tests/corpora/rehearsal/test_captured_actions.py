"""Actions that were cut from people and animators are whole, and are stored as closely as their unit says."""

import numpy as np
import pytest
from scripts.make_captured_actions import LICENCES, PICKS, keys_of

from echoavatar.json_reader import read_object_file
from echoavatar_lab.corpora.controls import neutral
from echoavatar_lab.corpora.rehearsal.captured_actions import TABLE, captured_actions, unpacked


@pytest.mark.parametrize("name", sorted(PICKS))
def test_an_action_leaves_rest_holds_and_comes_back(name: str) -> None:
    action = captured_actions()[name]
    wrist = action.controls.wrist
    rest = neutral(1).wrist[0]
    assert np.abs(wrist[[0, -1]] - rest).max() < 0.02
    first, last = action.hold
    away = np.linalg.norm(wrist - rest, axis=-1).max(1)
    assert away[round(first * 30) : round(last * 30) + 1].mean() > 0.15  # metres
    assert 0 < first < last < len(wrist) / 30
    row = read_object_file(TABLE)[name]
    assert row["licence"] == LICENCES[row["source"].split("/")[0]]


def test_what_is_kept_comes_back() -> None:
    action = next(iter(captured_actions().values()))
    kept = unpacked({"about": action.about, "hold": action.hold, **keys_of(action.controls)})
    assert np.abs(kept.controls.packed() - action.controls.packed()).max() < 0.002
    assert (kept.about, kept.hold) == (action.about, action.hold)
