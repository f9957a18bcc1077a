import shutil
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.engine.pipeline import ActionLibrary, load_bundle
from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar_lab.corpora.rehearsal import own_actions
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS


def test_every_built_in_action_is_made_for_the_bundles_tokenizer(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(tiny_bundle, tmp_path / "mine"))
    assert main(["actions", "build", "--model", str(folder)]) == 0
    assert f"{len(SCRIPTS)} actions in {folder / 'actions.json'}" in capsys.readouterr().out
    assert set(ActionLibrary.load(folder, 8)) == set(SCRIPTS)


def test_of_a_shipped_model_the_copy_is_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    few = dict(list(SCRIPTS.items())[:5])
    monkeypatch.setattr(own_actions, "SCRIPTS", few)
    assert main(["actions", "build"]) == 0
    assert f"5 actions in {Path('my-default/actions.json')}" in capsys.readouterr().out
    assert set(load_bundle("my-default").actions) == set(few)


def test_a_bundle_of_another_rig_is_refused(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(tiny_bundle, tmp_path / "mine"))
    rig = RigConfig(axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)), metres_per_unit=1, up=1)
    Runtime.load(folder).model_copy(update={"rig": rig}).save(folder)
    assert main(["actions", "build", "--model", str(folder)]) == 1
    assert "`echoavatar actions add`" in capsys.readouterr().err
