"""Actions that were cut from people and animators are whole, and are stored as closely as their unit says."""

import json
from pathlib import Path

import numpy as np
import pytest

from echoavatar_lab.corpora.controls import neutral
from echoavatar_lab.corpora.rehearsal import captured_actions as module
from echoavatar_lab.corpora.rehearsal.captured_actions import LICENCES, PICKS, captured_actions, save


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
    assert action.licence in LICENCES.values()
    assert action.source.split("/")[0] in LICENCES


def test_what_is_saved_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = dict(list(captured_actions().items())[:2])
    monkeypatch.setattr(module, "TABLE", tmp_path / "actions.json")
    save(made)
    kept = captured_actions.__wrapped__()
    assert list(json.loads((tmp_path / "actions.json").read_text())) == list(made)
    for name, action in made.items():
        assert np.abs(kept[name].controls.packed() - action.controls.packed()).max() < 0.002
        assert (kept[name].about, kept[name].hold) == (action.about, action.hold)
