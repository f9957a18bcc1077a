import shutil
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip


@pytest.fixture
def bundle(tiny_bundle: Path, tmp_path: Path) -> Path:
    shutil.copytree(tiny_bundle, tmp_path / "mine")
    ActionLibrary({"bow": Action("bow", (5, 6, 7, 5), (0, 1), "a bow")}).save(tmp_path / "mine")
    return tmp_path / "mine"


def test_a_clip_is_added_listed_and_removed(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nod = clip(SCRIPTS["agree"])
    write_bvh(tmp_path / "nod.bvh", nod.skeleton, nod.rotations, nod.root, fps=nod.fps)
    words = ["actions", "add", "big nod", str(tmp_path / "nod.bvh"), "--model", str(bundle), "--about", "yes!"]
    assert main(words) == 0
    assert main(["actions", "list", "--model", str(bundle)]) == 0
    told = capsys.readouterr().out
    assert "big_nod   2.7 s  yes!" in told
    assert "2 actions" in told
    assert main(["actions", "remove", "bow", "--model", str(bundle)]) == 0
    assert list(ActionLibrary.load(bundle, 8)) == ["big_nod"]


def test_errors_name_their_cause(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["actions", "remove", "jump", "--model", str(bundle)]) == 1
    assert "there are: bow" in capsys.readouterr().err
    assert main(["actions", "add", "x", "x.bvh", "--model", "default"]) == 1
    assert "not a bundle's folder" in capsys.readouterr().err
