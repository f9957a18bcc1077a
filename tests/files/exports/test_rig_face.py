"""The face on the user's own character, wherever its file says what its morph targets are."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.exports.bodies import child, long_armed
from tests.motion.formats.repacked import taken_apart, values

from echoavatar.files.avatar.gltf import container
from echoavatar.files.exports import Take, read_rig
from echoavatar.files.exports.rig_face import face_on, target_names
from echoavatar.files.exports.target_rig import pack_on_rig
from echoavatar.limits import MORPHS
from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES, to_vrm

PATH, TARGET = Path("a.glb"), {"POSITION": 0}
OPEN = np.zeros((1, 52), np.float32)
OPEN[0, ARKIT_NAMES.index("jawOpen")] = 0.5
Document = dict[str, Any]


def face(names: list[str] | None, count: int = 0, **more: Any) -> Document:
    """A document of one mesh with these morph targets."""
    mesh: Document = {"primitives": [{"targets": [TARGET] * (count or len(names or []))}]}
    if names:
        mesh["extras"] = {"targetNames": names}
    return {"nodes": [{"mesh": 0}], "meshes": [mesh], **more}


def expressions(kind: str, *rows: tuple[str, int]) -> Document:
    made = {name: {"morphTargetBinds": [{"node": 0, "index": index, "weight": 0.5}]} for name, index in rows}
    return {"extensions": {"VRMC_vrm": {"expressions": {kind: made}}}}


def vrm0(*rows: tuple[str, str, int]) -> Document:
    groups = [
        {"presetName": preset, "name": name, "binds": [{"mesh": 0, "index": index, "weight": 100}]}
        for preset, name, index in rows
    ]
    return {"extensions": {"VRM": {"blendShapeMaster": {"blendShapeGroups": groups}}}}


@pytest.mark.parametrize(
    ("document", "wanted"),
    [
        (face(["blendShape1.jawOpen", "other"]), {0: [0.5, 0]}),
        (face(["Fcl_MTH_A", "Fcl_MTH_I"]), {0: [0.8, 0]}),
        (face(None, 2, **expressions("preset", ("aa", 1))), {0: [0, 0.4]}),
        (face(None, 2, **expressions("custom", ("jawOpen", 1), ("eyeBlinkLeft", 0))), {0: [0, 0.25]}),
        (face(None, 2, **vrm0(("a", "A", 1), ("unknown", "TongueOut", 0))), {0: [0, 0.8]}),
        (face(list(ARKIT_NAMES), **vrm0(("a", "A", 1))), {0: list(OPEN[0])}),
        (face(None, 2), {}),
    ],
)
def test_names_or_expressions_drive_it_whichever_show_more(document: Document, wanted: dict[int, list[float]]) -> None:
    found = face_on(PATH, document, OPEN)
    assert {node: weights[0].tolist() for node, weights in found.items()} == {
        node: pytest.approx(weights) for node, weights in wanted.items()
    }


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["meshes"][0]["primitives"][0].update(extras={"targetNames": ["jawOpen"]}),
        lambda d: d["meshes"][0]["primitives"][0]["targets"][0].update(extra={"name": "jawOpen"}),
        lambda d: d["meshes"][0]["primitives"][0]["targets"][0].update(extras={"name": "jawOpen"}),
        lambda d: d.update(accessors=[{"name": "jawOpen"}]),
        lambda d: (d["meshes"][0].update(extras={"targetNames": [""] * 2}), d.update(accessors=[{"name": "jawOpen"}])),
    ],
)  # fmt: skip
def test_names_are_found_where_exporters_write_them(change: Callable[[Document], object]) -> None:
    document: Document = {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"targets": [dict(TARGET)]}]}]}
    change(document)
    assert target_names(document, document["meshes"][0]) == ["jawOpen"]
    assert face_on(PATH, document, OPEN)[0] == pytest.approx(0.5)


def test_52_targets_without_names_are_those_of_arkit() -> None:
    """In Apple's order, or in that of the alphabet where its jaw moves the face farther."""
    mesh = {"primitives": [{"targets": [{"POSITION": k} for k in range(52)]}]}
    for order in (list(APPLE_NAMES), sorted(APPLE_NAMES)):
        places = [{"min": [0, -0.03 if name == "jawOpen" else -0.01, 0], "max": [0, 0, 0]} for name in order]
        document = {"accessors": places, "nodes": [{"mesh": 0}], "meshes": [mesh]}
        assert target_names(document, mesh) == order
        assert face_on(PATH, document, OPEN)[0][0, order.index("jawOpen")] == 0.5
    assert target_names({}, {"primitives": [{"targets": [{}] * 51}]}) == [n for n in APPLE_NAMES if n != "tongueOut"]
    assert target_names({}, {"primitives": [{"targets": [{}] * 50}]}) == [""] * 50


def test_one_warning_says_what_nothing_shows(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        face_on(PATH, face(list(APPLE_NAMES)), OPEN)
        assert caplog.messages == []
        face_on(PATH, face([name for name in APPLE_NAMES if name not in ("jawOpen", "tongueOut")]), OPEN)
        face_on(PATH, face(["jawOpen"]), OPEN)
        face_on(PATH, face(["Hat", "Coat"]), OPEN)
    assert caplog.messages[0] == "a.glb: nothing on its face shows jawOpen, tongueOut"
    assert caplog.messages[1].endswith("eyeSquintLeft and 45 more")
    assert caplog.messages[2].startswith("a.glb: its face stays still")
    assert len(caplog.messages) == 3


@pytest.mark.parametrize(
    "name", ["head.jawOpen", "Head.M_Mouth_Open", "AU26", "あ", "vrc.v_aa", "CTRL_expressions_jawOpen"]
)
def test_the_exported_file_opens_its_mouth(tmp_path: Path, short: Take, name: str) -> None:
    document, binary = taken_apart(long_armed())
    document["meshes"][1]["extras"] = {"targetNames": [name]}
    (tmp_path / "a.glb").write_bytes(container(document, binary))
    rig = read_rig(tmp_path / "a.glb")
    assert rig.gltf is not None
    document, binary = taken_apart(pack_on_rig(rig.gltf, rig.retarget(short)))
    (animation,) = document["animations"]
    (channel,) = [entry for entry in animation["channels"] if entry["target"]["path"] == "weights"]
    weights = values(document, binary, animation["samplers"][channel["sampler"]]["output"])[:, 0]
    assert short.face is not None
    assert np.corrcoef(weights, short.face[:, ARKIT_NAMES.index("jawOpen")])[0, 1] > 0.4
    assert weights.max() > 0.5


def test_the_vowels_of_a_vrm_are_those_of_arkit(short: Take, tmp_path: Path) -> None:
    (tmp_path / "a.vrm").write_bytes(child())
    rig = read_rig(tmp_path / "a.vrm")
    assert rig.gltf is not None
    assert short.face is not None
    (weights,) = face_on(PATH, rig.gltf.document, short.face).values()
    np.testing.assert_allclose(weights, to_vrm(short.face)[:, :5], atol=1e-6)


def test_more_morph_targets_than_are_read_are_refused() -> None:
    """One mesh, again and again: the file stays small."""
    mesh = {"primitives": [{"targets": [{}] * 1_000}]}
    document = {"nodes": [{"mesh": 0}] * (MORPHS // 1_000 + 1), "meshes": [mesh]}
    with pytest.raises(ValueError, match="more than 8,192"):
        face_on(PATH, document, np.zeros((1, 52), np.float32))
