import json
import shutil
import sys
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.engine.pipeline import Action, ActionLibrary, load_bundle
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import Skeleton
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
    assert main(["actions", "add", "x", "x.bvh", "--model", str(bundle.parent)]) == 1
    assert "not a bundle's folder" in capsys.readouterr().err


def test_a_shipped_model_is_copied_before_its_actions_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nod = clip(SCRIPTS["agree"])
    write_bvh(tmp_path / "nod.bvh", nod.skeleton, nod.rotations, nod.root, fps=nod.fps)
    monkeypatch.chdir(tmp_path)
    for name in ("big nod", "deep nod"):
        assert main(["actions", "add", name, "nod.bvh"]) == 0
        assert "--model my-default" in capsys.readouterr().out
    shipped, own = load_bundle("default").actions, load_bundle(tmp_path / "my-default").actions
    assert set(own) - set(shipped) == {"big_nod", "deep_nod"}
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["my-default"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["add", "nod", "none.bvh"], "does not exist"),
        (["add", "../nod", "nod.bvh"], "cannot name an action"),
        (["remove", "jump"], "no action"),
    ],
)
def test_a_shipped_model_is_not_copied_for_what_cannot_be(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nod = clip(SCRIPTS["agree"])
    write_bvh(tmp_path / "nod.bvh", nod.skeleton, nod.rotations, nod.root, fps=nod.fps)
    monkeypatch.chdir(tmp_path)
    assert main(["actions", *words]) == 1
    told = capsys.readouterr()
    assert said in told.err
    assert not told.out
    assert [path.name for path in tmp_path.iterdir()] == ["nod.bvh"]


def test_without_the_lab_a_tokenizer_needs_its_graphs(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped one has them; the tiny one has none."""
    wave = clip(SCRIPTS["wave"])
    write_bvh(tmp_path / "wave.bvh", wave.skeleton, wave.rotations, wave.root, fps=wave.fps)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "echoavatar_lab", None)
    monkeypatch.delitem(sys.modules, "echoavatar_lab.torch_backend", raising=False)
    assert main(["actions", "add", "big wave", "wave.bvh", "--model", str(bundle)]) == 1
    assert "pip install ./lab" in capsys.readouterr().err
    assert main(["actions", "add", "big wave", "wave.bvh"]) == 0
    assert len(set(load_bundle("my-default").actions["big_wave"].codes)) > 1


def test_a_clip_with_names_of_its_own_is_added_by_a_map(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nod = clip(SCRIPTS["agree"])
    nowhere = nod.skeleton.config.model_copy(
        update={"names": tuple(f"j{k}" for k in range(nod.skeleton.joints)), "vrm": {}, "tips": {}}
    )
    offsets = [tuple(2.0 * x if name == "leftLowerLeg" else x for x in offset)
               for name, offset in zip(nod.skeleton.names, nowhere.offsets, strict=True)]  # fmt: skip
    rig = Skeleton(nowhere.model_copy(update={"offsets": tuple(offsets)}))
    write_bvh(tmp_path / "nod.bvh", rig, nod.rotations, nod.root, fps=nod.fps)
    words = ["actions", "add", "nod", str(tmp_path / "nod.bvh"), "--model", str(bundle)]
    assert main(words) == 1
    assert "no joint is hips" in capsys.readouterr().err
    (tmp_path / "map.json").write_text(json.dumps({bone: f"j{k}" for bone, k in nod.skeleton.config.vrm.items()}))
    assert main([*words, "--map", str(tmp_path / "map.json")]) == 0
    assert main([*words, "--map", str(tmp_path / "none.json")]) == 1
    assert "none.json does not exist" in capsys.readouterr().err
