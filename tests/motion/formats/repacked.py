"""The same GLB in the forms that programs export: compressed, in several files, sparse, interleaved."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echoavatar.files.avatar.gltf import container

Document = dict[str, Any]
TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
PICTURE = b"\x89PNG\r\n\x1a\n"  # as much of one as is looked at


def taken_apart(data: bytes) -> tuple[Document, bytes]:
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def values(document: Document, data: bytes, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = TYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
    found = np.frombuffer(data, kind, accessor["count"] * width, view["byteOffset"])
    return found.reshape(accessor["count"], width)


class Collected:
    """Bytes, each piece at a multiple of four."""

    def __init__(self) -> None:
        self.data = bytearray()

    def add(self, piece: bytes) -> dict[str, int]:
        place = {"byteOffset": len(self.data), "byteLength": len(piece)}
        self.data += piece + bytes(-len(piece) % 4)
        return place


def with_meshopt(data: bytes, name: str = "EXT_meshopt_compression") -> bytes:
    """Every view compressed; its second buffer has no bytes."""
    meshopt = pytest.importorskip("meshopt", reason="needs echoavatar[gltf]")
    document, binary = taken_apart(data)
    packed, plain = Collected(), Collected()
    triangles = {part["indices"] for mesh in document["meshes"] for part in mesh["primitives"]}
    for index, accessor in enumerate(document["accessors"]):
        rows = values(document, binary, index)
        mode = "TRIANGLES" if index in triangles else "ATTRIBUTES"
        stored = meshopt.encode_gltf_buffer(np.ascontiguousarray(rows[:, 0] if mode == "TRIANGLES" else rows), mode)
        entry = packed.add(stored) | {"buffer": 0, "byteStride": rows[0].nbytes, "count": len(rows), "mode": mode}
        view: Document = plain.add(rows.tobytes()) | {"buffer": 1, "extensions": {name: entry}}
        if mode == "ATTRIBUTES" and accessor["type"] in ("VEC2", "VEC3", "VEC4"):
            view["byteStride"] = rows[0].nbytes
        document["bufferViews"][accessor["bufferView"]] = view
    empty = {"byteLength": len(plain.data), "extensions": {name: {"fallback": True}}}
    document["buffers"] = [{"byteLength": len(packed.data)}, empty]
    document["extensionsUsed"] = document["extensionsRequired"] = [*document.get("extensionsUsed", []), name]
    return container(document, packed.data)


def with_draco(data: bytes) -> bytes:
    """The skinned meshes compressed; those with morph targets as they were."""
    DracoPy = pytest.importorskip("DracoPy", reason="needs echoavatar[gltf]")
    document, binary = taken_apart(data)
    parts = Collected()
    parts.data = bytearray(binary)
    for mesh in document["meshes"]:
        for part in mesh["primitives"]:
            held = part["attributes"]
            if "JOINTS_0" not in held:
                continue
            arrays = {name: values(document, binary, index) for name, index in held.items()}
            triangles = values(document, binary, part["indices"]).reshape(-1, 3)
            places, normals = arrays["POSITION"], arrays["NORMAL"].astype(float)
            generic = {5: arrays["JOINTS_0"], 7: arrays["WEIGHTS_0"]}
            stored = DracoPy.encode(
                places, triangles, normals=normals, generic_attributes=generic, quantization_bits=20
            )
            mesh_of = DracoPy.decode(stored)
            kinds = {found["attribute_type"]: found["unique_id"] for found in mesh_of.attributes}
            ids = {"POSITION": kinds[0], "NORMAL": kinds[1], "JOINTS_0": 5, "WEIGHTS_0": 7}
            view = parts.add(stored) | {"buffer": 0}
            document["bufferViews"].append(view)
            entry = {"bufferView": len(document["bufferViews"]) - 1, "attributes": ids}
            part["extensions"] = {"KHR_draco_mesh_compression": entry}
            for index in (*held.values(), part["indices"]):
                del document["accessors"][index]["bufferView"]
                document["accessors"][index]["count"] = len(mesh_of.points)
            document["accessors"][part["indices"]]["count"] = mesh_of.faces.size
    document["buffers"] = [{"byteLength": len(parts.data)}]
    document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return container(document, parts.data)


def with_sparse_positions(data: bytes) -> bytes:
    """All positions sparse, on zeros."""
    document, binary = taken_apart(data)
    parts = Collected()
    parts.data = bytearray(binary)
    index = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    accessor = document["accessors"][index]
    places = np.arange(accessor["count"], dtype=np.uint32)[::-1]
    document["bufferViews"].append(parts.add(places.tobytes()) | {"buffer": 0})
    document["bufferViews"].append(parts.add(values(document, binary, index)[::-1].tobytes()) | {"buffer": 0})
    del accessor["bufferView"]
    accessor["sparse"] = {
        "count": accessor["count"],
        "indices": {"bufferView": len(document["bufferViews"]) - 2, "componentType": 5125},
        "values": {"bufferView": len(document["bufferViews"]) - 1},
    }
    document["buffers"] = [{"byteLength": len(parts.data)}]
    return container(document, parts.data)


def interleaved(data: bytes) -> bytes:
    """Each vertex's place, joints and weights side by side; weights as bytes."""
    document, binary = taken_apart(data)
    parts = Collected()
    parts.data = bytearray(binary)
    held = document["meshes"][0]["primitives"][0]["attributes"]
    rows, at, count = [], 0, len(values(document, binary, held["POSITION"]))
    for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"):
        column = values(document, binary, held[name])
        if name == "WEIGHTS_0":
            column = np.round(column * 255).astype(np.uint8)
            document["accessors"][held[name]] |= {"componentType": 5121, "normalized": True}
        document["accessors"][held[name]] |= {"bufferView": len(document["bufferViews"]), "byteOffset": at}
        rows.append(np.ascontiguousarray(column).view(np.uint8).reshape(count, -1))
        at += rows[-1].shape[1]
    document["bufferViews"].append(parts.add(np.concatenate(rows, 1).tobytes()) | {"buffer": 0, "byteStride": at})
    document["buffers"] = [{"byteLength": len(parts.data)}]
    return container(document, parts.data)


def oddly_drawn(data: bytes) -> bytes:
    """Unlit and clear surfaces, a second set of coordinates, colours of vertices, lines and points, a second scene."""
    document, binary = taken_apart(data)
    parts = Collected()
    parts.data = bytearray(binary)
    held = document["meshes"][0]["primitives"][0]["attributes"]
    count = document["accessors"][held["POSITION"]]["count"]
    for name, kind in (("TEXCOORD_0", "VEC2"), ("TEXCOORD_1", "VEC2"), ("COLOR_0", "VEC4")):
        rows = np.full((count, WIDTHS[kind]), 0.5, np.float32)
        document["bufferViews"].append(parts.add(rows.tobytes()) | {"buffer": 0})
        held[name] = len(document["accessors"])
        entry = {"bufferView": len(document["bufferViews"]) - 1, "componentType": 5126, "count": count, "type": kind}
        document["accessors"].append(entry)
    document["meshes"][0]["primitives"] += [
        {"attributes": {"POSITION": held["POSITION"]}, "mode": mode, "material": 2} for mode in (0, 1, 2, 3)
    ]
    document["materials"] = [
        {"extensions": {"KHR_materials_unlit": {}}, "alphaMode": "BLEND", "doubleSided": True},
        {"alphaMode": "MASK", "alphaCutoff": 0.3, "emissiveFactor": [0.2, 0.2, 0.2]},
        {},
    ]
    document["scenes"].append({"nodes": document["scenes"][0]["nodes"]})
    document["extensionsUsed"] = ["KHR_materials_unlit"]
    document["buffers"] = [{"byteLength": len(parts.data)}]
    return container(document, parts.data)


def in_parts(data: bytes, folder: Path) -> Path:
    """A `.gltf` with half its bytes in a folder beside it, half in its text, and a picture."""
    document, binary = taken_apart(data)
    middle = document["bufferViews"][len(document["bufferViews"]) // 2]["byteOffset"]
    for view in document["bufferViews"]:
        if view["byteOffset"] >= middle:
            view |= {"buffer": 1, "byteOffset": view["byteOffset"] - middle}
    (folder / "my parts").mkdir(parents=True)
    (folder / "my parts" / "körper.bin").write_bytes(binary[:middle])
    (folder / "skin#1.png").write_bytes(PICTURE)
    text = base64.b64encode(binary[middle:]).decode()
    document["buffers"] = [
        {"uri": "my%20parts/k%C3%B6rper.bin", "byteLength": middle},
        {"uri": f"data:application/octet-stream;base64,{text}", "byteLength": len(binary) - middle},
    ]
    document["images"] = [{"uri": "skin%231.png"}]
    path = folder / "a.gltf"
    path.write_text(json.dumps(document), "utf-8")
    return path
