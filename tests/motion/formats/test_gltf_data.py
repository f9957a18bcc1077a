"""A character in the forms that programs export is the same character, and what states too much is refused."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree
from tests.files.exports.bodies import MIXAMO, child, long_armed
from tests.files.exports.moving import clapping
from tests.files.exports.readers import node
from tests.motion.formats.repacked import (
    PICTURE,
    in_parts,
    interleaved,
    oddly_drawn,
    taken_apart,
    with_draco,
    with_meshopt,
    with_sparse_positions,
)

from echoavatar.errors import DependencyError, MotionError
from echoavatar.files.avatar.gltf import container
from echoavatar.files.exports import Take, read_rig, read_take, write_take
from echoavatar.files.exports.target_rig import pack_on_rig
from echoavatar.motion.formats.gltf_data import Gltf, read_chunks
from echoavatar.motion.formats.gltf_rig import Skinned, read_skinned

FORMS: dict[str, Callable[[bytes], bytes]] = {
    "meshopt": with_meshopt,
    "draco": with_draco,
    "sparse": with_sparse_positions,
    "interleaved": interleaved,
    "oddly drawn": oddly_drawn,
    "newer meshopt": lambda data: with_meshopt(data, "KHR_meshopt_compression"),
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Skinned:
    path = tmp_path_factory.mktemp("plain") / "a.glb"
    path.write_bytes(long_armed())
    return read_skinned(path)


@pytest.fixture(scope="module")
def short() -> Take:
    return Take(clapping().cut(0, 10), None, None)


def apart(one: Skinned, other: Skinned) -> float:
    """How far the vertices are from those of the same joints of the other, whatever the order of both."""
    owners = [
        np.take_along_axis(read.weights.joints, read.weights.shares.argmax(1)[:, None], 1) for read in (one, other)
    ]
    rows = [np.concatenate([read.vertices, owner], 1) for read, owner in zip((one, other), owners, strict=True)]
    return max(float(KDTree(a).query(b)[0].max()) for a, b in (rows, rows[::-1]))


@pytest.mark.parametrize("form", FORMS)
def test_a_character_in_another_form_is_the_same(tmp_path: Path, plain: Skinned, form: str) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(FORMS[form](long_armed()))
    read = read_skinned(path)
    np.testing.assert_allclose(read.weights.shares.sum(1), 1, atol=1e-6)
    if form != "draco":
        np.testing.assert_allclose(read.vertices, plain.vertices, atol=1e-6)
        for joint in range(read.skeleton.joints):
            np.testing.assert_allclose(read.weights.on([joint]), plain.weights.on([joint]), atol=1e-6)
    assert read.skeleton.config == plain.skeleton.config
    assert apart(read, plain) < 2e-3


@pytest.mark.parametrize("form", FORMS)
def test_motion_is_written_into_it_and_what_was_compressed_still_is(tmp_path: Path, short: Take, form: str) -> None:
    path, out = tmp_path / "a.glb", tmp_path / "out.glb"
    path.write_bytes(FORMS[form](long_armed()))
    rig = read_rig(path)
    assert rig.gltf is not None
    out.write_bytes(pack_on_rig(rig.gltf, rig.retarget(short)))
    before, after = read_skinned(path), read_skinned(out)
    np.testing.assert_array_equal(before.vertices, after.vertices)
    required = read_chunks(path).document.get("extensionsRequired")
    assert read_chunks(out).document.get("extensionsRequired") == required
    if form in ("draco", "newer meshopt"):
        return  # the validator does not know them, nor does three.js outside a browser
    hands = [rig.skeleton.names[rig.skeleton.config.vrm[bone]] for bone in ("leftHand", "rightHand")]
    told = node("read_glb.mjs", out, *hands)
    places = rig.retarget(short).motion.pose().positions
    for hand, name in zip(("leftHand", "rightHand"), hands, strict=True):
        found = np.array(told["places"][name])
        np.testing.assert_allclose(found, places[: len(found), rig.skeleton.config.vrm[hand]], atol=1e-3)


def test_a_gltf_is_read_with_its_parts_and_written_as_one(tmp_path: Path, plain: Skinned, short: Take) -> None:
    path = in_parts(long_armed(), tmp_path / "in")
    rig = read_rig(path)
    assert rig.gltf is not None
    np.testing.assert_allclose(read_skinned(path).vertices, plain.vertices, atol=1e-6)
    (tmp_path / "a.glb").write_bytes(pack_on_rig(rig.gltf, rig.retarget(short)))
    document, binary = taken_apart((tmp_path / "a.glb").read_bytes())
    assert [set(buffer) for buffer in document["buffers"]] == [{"byteLength"}]
    (image,) = document["images"]
    view = document["bufferViews"][image["bufferView"]]
    assert image["mimeType"] == "image/png"
    assert binary[view["byteOffset"] :][: view["byteLength"]] == PICTURE
    np.testing.assert_allclose(read_skinned(tmp_path / "a.glb").vertices, plain.vertices, atol=1e-6)


@pytest.mark.parametrize(
    "written",
    [
        lambda text: text.replace("%20parts/", "%20parts\\\\"),
        lambda text: re.sub(r"=+(?=\")", "", text),
        lambda text: text.replace("data:application", "DATA:application").replace(";base64", ";BASE64"),
        lambda text: re.sub("(?<=base64,)[^\"]+", lambda found: found[0].translate(str.maketrans("+/", "-_")), text),
        lambda text: re.sub("(?<=base64,)[^\"]+", lambda found: found[0].replace("A", "A\\n", 3), text),
        lambda text: text.replace('"scale": ', '"mesh": null, "skin": -1, "children": null, "scale": ', 1),
        lambda text: json.dumps(_with_nulls(json.loads(text))),
        lambda text: text.replace("rper.bin", "RPER.BIN"),
        lambda text: f"{text}\0\0\n",
    ],
    ids=["backslash", "no padding", "capitals", "URL-safe", "lines", "nothing", "nulls", "another case", "NUL behind"],
)  # fmt: skip
def test_a_gltf_may_be_written_loosely(tmp_path: Path, plain: Skinned, written: Callable[[str], str]) -> None:
    path = in_parts(long_armed(), tmp_path / "in")
    text = path.read_text("utf-8")
    changed = written(text)
    assert changed != text
    path.write_text(changed, "utf-8")
    np.testing.assert_allclose(read_skinned(path).vertices, plain.vertices, atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "cp1252"])
def test_the_text_of_a_gltf_may_have_any_encoding(tmp_path: Path, plain: Skinned, encoding: str) -> None:
    path = in_parts(long_armed(), tmp_path / "in")
    document = json.loads(path.read_text("utf-8")) | {"extras": "Größe"}
    path.write_bytes(json.dumps(document, ensure_ascii=False).encode(encoding))
    np.testing.assert_allclose(read_skinned(path).vertices, plain.vertices, atol=1e-6)


def _with_nulls(document: dict[str, Any]) -> dict[str, Any]:
    keys = ("children", "mesh", "skin", "matrix", "rotation", "scale", "translation", "camera")
    for entry in document["nodes"]:
        entry |= {key: None for key in keys if key not in entry}
    absent = {"animations": None, "cameras": None, "extensions": {"VRM": None, "VRMC_vrm": None}}
    return absent | document


@pytest.mark.parametrize(
    ("uri", "problem"),
    [
        ("../secret.bin", "outside its folder"),
        ("%2e%2e/secret.bin", "outside its folder"),
        ("/etc/hostname", "outside its folder"),
        ("link.bin", "outside its folder"),
        ("file:///etc/hostname", "outside its folder"),
        ("https://example.org/a.bin", "outside its folder"),
        ("none.bin", "put it beside"),
        ("loop.bin", "cannot be read"),
        (".", "regular file"),
        ("%00", "glTF format"),
        ("%ff.bin", "glTF format"),
        ("data:;base64,*", "glTF format"),
        (7, "glTF format"),
    ],
)
def test_nothing_outside_its_folder_is_read(tmp_path: Path, uri: object, problem: str) -> None:
    path = in_parts(long_armed(), tmp_path / "in")
    (tmp_path / "secret.bin").write_bytes(bytes(100_000))
    (tmp_path / "in" / "link.bin").symlink_to(tmp_path / "secret.bin")
    (tmp_path / "in" / "loop.bin").symlink_to("loop.bin")
    document = json.loads(path.read_text("utf-8"))
    document["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(MotionError, match=problem):
        read_skinned(path)


def test_a_vrm_of_rigid_parts_on_its_bones_is_read(tmp_path: Path, short: Take) -> None:
    document, binary = taken_apart(child())
    del document["skins"], document["nodes"][next(k for k, n in enumerate(document["nodes"]) if "skin" in n)]["skin"]
    hand = next(node for node in document["nodes"] if node["name"] == "bone_leftHand")
    document["nodes"].append({"mesh": 1, "name": "glove"})
    hand.setdefault("children", []).append(len(document["nodes"]) - 1)
    path = tmp_path / "a.vrm"
    path.write_bytes(container(document, binary))
    rig, read = read_rig(path), read_skinned(path)
    of_hand = read.vertices[read.weights.on([rig.skeleton.config.vrm["leftHand"]]) == 1]
    np.testing.assert_allclose(
        of_hand.mean(0), read.skeleton.rest_positions[rig.skeleton.config.vrm["leftHand"]], atol=1e-3
    )
    assert read.weights.on([rig.skeleton.config.vrm["hips"]]).sum() > 100  # the body hangs on no bone
    assert rig.gltf is not None
    pack_on_rig(rig.gltf, rig.retarget(short))


def test_it_is_read_by_its_content_whatever_it_is_called(tmp_path: Path) -> None:
    binary, text = tmp_path / "a.gltf", tmp_path / "b.glb"
    binary.write_bytes(long_armed())
    text.write_bytes(b"\xef\xbb\xbf" + in_parts(long_armed(), tmp_path).read_bytes())
    for path in (binary, text):
        assert read_rig(path).skeleton.joints == len(MIXAMO)


def without_meshes(document: dict[str, Any]) -> None:
    del document["skins"]
    for entry in document["nodes"]:
        entry.pop("mesh", None)
        entry.pop("skin", None)


def test_a_skeleton_without_a_mesh_is_a_rig(tmp_path: Path, short: Take) -> None:
    document, binary = taken_apart(long_armed())
    without_meshes(document)
    path, out = tmp_path / "a.glb", tmp_path / "b.glb"
    path.write_bytes(container(document, binary))
    write_take(out, short, rig=read_rig(path))
    assert read_take(out).motion.frames == short.motion.frames
    with pytest.raises(MotionError, match="a skeleton without a mesh"):
        write_take(tmp_path / "b.mp4", short, rig=read_rig(path))


def test_a_body_of_rigid_parts_needs_no_skin(tmp_path: Path, short: Take) -> None:
    """A robot: each bone has a mesh of its own. A mesh beside the bones follows none, and is refused."""
    document, binary = taken_apart(long_armed())
    without_meshes(document)
    bare = json.dumps(document)
    for bone in [entry for entry in document["nodes"] if "Leg" in entry["name"] or "Arm" in entry["name"]]:
        bone.setdefault("children", []).append(len(document["nodes"]))
        document["nodes"].append({"mesh": 1, "name": f"part of {bone['name']}"})
    path = tmp_path / "a.glb"
    path.write_bytes(container(document, binary))
    rig = read_rig(path)
    assert rig.gltf is not None
    pack_on_rig(rig.gltf, rig.retarget(short))
    document = json.loads(bare)
    document["nodes"].append({"mesh": 1, "name": "body"})
    path.write_bytes(container(document, binary))
    with pytest.raises(MotionError, match="has no skin"):
        read_rig(path)


def test_what_unpacks_it_may_be_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.glb"
    for form, module in (("meshopt", "meshopt"), ("draco", "DracoPy")):
        path.write_bytes(FORMS[form](long_armed()))
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(DependencyError, match=r"echoavatar\[gltf\]"):
            read_skinned(path)


def test_normalised_integers_are_parts_of_one() -> None:
    stored = np.array([[-128, -127, 0, 127]], np.int8)
    document = {
        "bufferViews": [{"buffer": 0, "byteLength": 4}],
        "accessors": [{"bufferView": 0, "componentType": 5120, "type": "VEC4", "count": 1, "normalized": True}],
    }
    np.testing.assert_array_equal(Gltf(Path(), document, stored.tobytes()).accessor(0, 1), [[-1, -1, 0, 1]])


def meshopt_of(change: dict[str, object]) -> bytes:
    document, binary = taken_apart(with_meshopt(long_armed()))
    for view in document["bufferViews"]:
        view["extensions"]["EXT_meshopt_compression"] |= change
    return container(document, binary)


@pytest.mark.parametrize(
    "change",
    [
        {"count": 10**12},
        {"count": 0},
        {"count": -5},
        {"count": 1 << 20, "byteStride": 256},
        {"byteStride": 3},
        {"byteLength": 5},
        {"byteOffset": 10**9},
        {"byteOffset": -4},
        {"mode": "NONE"},
        {"filter": "OCTAHEDRAL"},
        {"count": "x"},
    ],
)
def test_compressed_data_that_lies_is_one_error(tmp_path: Path, change: dict[str, object]) -> None:
    (tmp_path / "a.glb").write_bytes(meshopt_of(change))
    with pytest.raises(MotionError, match=r"a\.glb"):
        read_skinned(tmp_path / "a.glb")
