"""Draco meshes come out as they went in, and one that is damaged or states too much is one error."""

from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import long_armed
from tests.motion.formats.repacked import taken_apart, with_draco

from echoavatar.errors import MotionError
from echoavatar.files.avatar.gltf import container
from echoavatar.motion.formats.draco import unpacked
from echoavatar.motion.formats.gltf_rig import read_skinned

DracoPy = pytest.importorskip("DracoPy", reason="needs echoavatar[gltf]")


def test_meshes_come_out_in_order_and_no_more_than_is_allowed() -> None:
    """Two meshes of 3 and 6 points, 12 bytes each: 108 bytes in all."""
    points = [np.random.default_rng(0).random((count, 3)).astype(np.float32) for count in (3, 6)]
    faces = [np.arange(len(each)).reshape(-1, 3) for each in points]
    stored = [DracoPy.encode(each, face, quantization_bits=24) for each, face in zip(points, faces, strict=True)]
    parts = [(data, {"POSITION": 0}) for data in stored]
    for found, each in zip(unpacked(parts, 108), points, strict=True):
        order = np.lexsort(found["POSITION"].T)
        np.testing.assert_allclose(found["POSITION"][order], each[np.lexsort(each.T)], atol=1e-5)
    with pytest.raises(ValueError, match="damaged, or takes more"):
        unpacked(parts, 107)


def test_a_damaged_draco_mesh_is_one_error(tmp_path: Path) -> None:
    document, binary = taken_apart(with_draco(long_armed()))
    at = document["bufferViews"][-1]["byteOffset"]
    for spoilt in (binary[: at + 20] + b"\xff" * 30 + binary[at + 50 :], binary[:at] + bytes(len(binary) - at)):
        (tmp_path / "a.glb").write_bytes(container(document, spoilt))
        with pytest.raises(MotionError, match=r"a\.glb"):
            read_skinned(tmp_path / "a.glb")
