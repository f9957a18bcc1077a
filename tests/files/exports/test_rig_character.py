"""The user's own character in a film: the pictures are looked at."""

import io
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from tests.files.exports.bodies import child, long_armed
from tests.motion.formats.repacked import Collected, taken_apart, with_draco, with_meshopt

from echoavatar.errors import MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.framing import VIEWS, View
from echoavatar.files.avatar.gltf import container, pack_glb
from echoavatar.files.avatar.video import Shot, film
from echoavatar.files.exports import Take, read_rig, rig_character, write_take
from echoavatar.files.exports.rig_character import film_character
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import Motion

Document = dict[str, Any]
RED, BLUE = (220, 30, 30, 255), (30, 30, 220, 255)


def still(path: Path, data: bytes, view: View = "front", *, jaw: float = 0.0, samples: int = 2) -> np.ndarray:
    """One picture (128, 96, 4) of a character at rest, without a backdrop."""
    path.write_bytes(data)
    rig = read_rig(path)
    face = np.zeros((1, 52), np.float32)
    face[0, ARKIT_NAMES.index("jawOpen")] = jaw
    character, weights = film_character(rig, face, 1)
    turns = np.zeros((1, rig.skeleton.joints, 4), np.float32)
    turns[..., 0] = 1
    motion = Motion(rig.skeleton, turns, rig.skeleton.rest_positions[:1], 30.0)
    shot = Shot((96, 128), view, alpha=True, samples=samples)
    return next(film(motion, face=weights, character=character, shot=shot)).astype(int)


def painted(data: bytes, picture: bytes, **material: Any) -> bytes:
    """The body with one picture all over it, three times as wide as its places say."""
    document, binary = taken_apart(data)
    parts = Collected()
    parts.data = bytearray(binary)
    part = document["meshes"][0]["primitives"][0]
    count = document["accessors"][part["attributes"]["POSITION"]]["count"]
    uvs = np.random.default_rng(0).uniform(-3, 5, (count, 2)).astype("<f4")
    document["bufferViews"] += [parts.add(piece) | {"buffer": 0} for piece in (uvs.tobytes(), picture)]
    views = len(document["bufferViews"])
    document["accessors"].append({"bufferView": views - 2, "componentType": 5126, "count": count, "type": "VEC2"})
    part["attributes"]["TEXCOORD_0"] = len(document["accessors"]) - 1
    document |= {"images": [{"bufferView": views - 1}], "textures": [{"source": 0}]}
    surface = document["materials"][0]["pbrMetallicRoughness"]
    surface |= {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, material.pop("alpha", 1)]}
    document["materials"][0] |= material
    document["buffers"] = [{"byteLength": len(parts.data)}]
    return container(document, parts.data)


def encoded(colour: tuple[int, ...], kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    Image.new("RGBA", (8, 8), colour).convert("RGB" if kind == "JPEG" else "RGBA").save(file, kind)
    return file.getvalue()


def share(picture: np.ndarray, channel: int) -> float:
    """Of the opaque pixels, those in which a colour rules."""
    seen = picture[picture[..., 3] > 200]
    others = np.delete(seen[:, :3], channel, 1)
    return float((seen[:, channel] > others.max(1) + 40).mean()) if len(seen) else 0.0


@pytest.mark.parametrize("view", ["front", "face"])
def test_our_own_character_looks_the_same_through_its_glb(tmp_path: Path, view: View) -> None:
    maya = load_character()
    through = still(tmp_path / "a.glb", pack_glb(maya, []), view)
    turns = np.zeros((1, 52, 4), np.float32)
    turns[..., 0] = 1
    motion = Motion(maya.skeleton, turns, maya.skeleton.rest_positions[:1], 30.0)
    own = next(film(motion, character=maya, shot=Shot((96, 128), view, alpha=True))).astype(int)
    assert np.abs(through - own).mean() < 1.5


@pytest.mark.parametrize("make", [child, long_armed])
@pytest.mark.parametrize("view", VIEWS)
def test_bodies_of_all_kinds_stand_in_the_picture(tmp_path: Path, make: Callable[[], bytes], view: View) -> None:
    """VRM 0.x that faces -Z, and an armature scaled by 0.01 with turned bones; the mouth tells front from back."""
    picture = still(tmp_path / "a.vrm", make(), view, jaw=1.0)
    seen = picture[..., 3] > 128
    assert 0.05 < seen.mean() < 0.97
    if view in ("front", "right", "left", "back"):
        rows, columns = np.nonzero(seen)
        assert (rows.min(), columns.min()) >= (2, 2)
        assert rows.max() < 126
        assert columns.max() < 94
    if view not in ("left", "right"):
        assert (share(picture, 0) > 0.001) == (view != "back")


def test_compressed_meshes_give_the_same_picture(tmp_path: Path) -> None:
    plain = still(tmp_path / "a.glb", long_armed())
    for pack in (with_meshopt, with_draco):
        assert np.abs(still(tmp_path / "b.glb", pack(long_armed())) - plain).mean() < 0.5, pack.__name__


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_pictures_of_every_kind_are_on_the_body(tmp_path: Path, kind: str) -> None:
    assert share(still(tmp_path / "a.glb", painted(long_armed(), encoded(BLUE, kind))), 2) > 0.9


@pytest.mark.parametrize(
    ("alpha", "material", "least", "most"),
    [
        (90, {}, 0.98, 1.01),
        (90, {"alphaMode": "MASK"}, 0.0, 0.02),
        (90, {"alphaMode": "MASK", "alphaCutoff": 0.2}, 0.98, 1.01),
        (255, {"alphaMode": "MASK", "alpha": 0.4}, 0.0, 0.02),
        (128, {"alphaMode": "BLEND", "doubleSided": True}, 0.4, 0.9),
        (255, {"alphaMode": "BLEND", "alpha": 0.0}, 0.0, 0.02),
    ],
)
def test_alpha_cuts_out_or_shows_through(
    tmp_path: Path, alpha: int, material: Document, least: float, most: float
) -> None:
    """How much covers the body above the floor, over what an opaque one covers."""
    picture = encoded((*BLUE[:3], alpha))
    pair = painted(long_armed(), picture, **dict(material)), painted(long_armed(), encoded(BLUE))
    covered, whole = (still(tmp_path / "a.glb", data)[:70, :, 3].sum() for data in pair)
    assert least <= covered / whole < most


def test_what_a_film_cannot_show_is_said_in_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document, binary = taken_apart(painted(long_armed(), b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60)))
    document["extensionsRequired"] = ["KHR_texture_basisu", "ACME_fur"]
    document["textures"] = [{"extensions": {"KHR_texture_basisu": document["textures"][0]}}]
    with caplog.at_level(logging.WARNING, "echoavatar.files.exports.rig_character"):
        picture = still(tmp_path / "a.glb", container(document, binary))
    (said,) = [record.getMessage() for record in caplog.records if record.name.endswith("rig_character")]
    assert "1 pictures (KTX2" in said
    assert "ACME_fur" in said
    assert "basisu" not in said
    assert (picture[..., 3] > 200).any()


def test_the_mouth_opens(tmp_path: Path) -> None:
    shut, wide = (still(tmp_path / "a.glb", long_armed(), "face", jaw=jaw) for jaw in (0.0, 1.0))
    assert share(wide, 0) > share(shut, 0) + 0.02


def test_a_film_with_a_rig_is_written_and_a_skeleton_is_refused(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    few = Take(short.motion.cut(0, 4), short.face[:4], None)  # type: ignore[index]
    shot = Shot((64, 96), samples=1)
    write_take(tmp_path / "a.mp4", few, rig=read_rig(rigs["child"]), shot=shot)
    with av.open(str(tmp_path / "a.mp4")) as container_:
        assert sum(1 for _ in container_.decode(video=0)) == 4
    with pytest.raises(MotionError, match=r"tall\.bvh is a skeleton without a mesh"):
        write_take(tmp_path / "b.mp4", few, rig=read_rig(rigs["tall"]), shot=shot)


def _nan(document: Document) -> None:
    document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [float("nan")] * 4


def _far(document: Document) -> None:
    document["meshes"][0]["primitives"][0]["indices"] = document["skins"][0]["inverseBindMatrices"]


def _no_picture(document: Document) -> None:
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 7}


@pytest.mark.parametrize("spoil", [_nan, _far, _no_picture])
def test_a_damaged_character_is_one_error(tmp_path: Path, spoil: Callable[[Document], None]) -> None:
    document, binary = taken_apart(long_armed())
    spoil(document)
    with pytest.raises(MotionError, match=r"a\.glb"):
        still(tmp_path / "a.glb", container(document, binary))


@pytest.mark.parametrize("limit", ["CORNERS", "MORPHED"])
def test_sizes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    monkeypatch.setattr(rig_character, limit, 20)
    with pytest.raises(MotionError, match="more than"):
        still(tmp_path / "a.glb", long_armed(), jaw=1.0)
