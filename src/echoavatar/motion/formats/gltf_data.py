"""Read the data of a glTF file: `.glb`, `.vrm`, or `.gltf` with its parts beside it.

The document is brought into one form: all bytes, those of pictures too, are in its first buffer, as in a `.glb`.
Compressed data stays compressed there, and is unpacked where numbers are read (`Gltf.accessor`, `Gltf.attribute`).
"""

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from jaxtyping import Float, Int

from echoavatar.errors import DependencyError, MotionError
from echoavatar.json_reader import from_base64, read_object
from echoavatar.limits import FILE_PARTS, GLB_BYTES, GLTF_BYTES, UNPACKED_BYTES, VERTICES, check_file, decoded

from . import draco

Array = np.ndarray
DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError, struct.error)
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TOGETHER = {"POSITION", "JOINTS_0", "WEIGHTS_0"}, {"NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0", "indices"}
_PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"\xabKTX": "image/ktx2"}


@dataclass(frozen=True)
class Gltf:
    """A document, the bytes of its first buffer, and what has been unpacked of these (`views`, `meshes`)."""

    path: Path
    document: dict[str, Any]
    data: bytes | bytearray
    views: dict[int, bytes] = field(init=False, default_factory=dict)
    meshes: dict[int, dict[str, Array]] = field(init=False, default_factory=dict)

    def attribute(self, part: dict[str, Any], name: str) -> Float[Array, "v n"]:
        """An attribute of a primitive, which may be in a Draco mesh. Raises ValueError: its data is damaged."""
        index = part["attributes"][name]
        entry = part.get("extensions", {}).get(DRACO)
        count = self.document["accessors"][part["attributes"]["POSITION"]]["count"]
        if entry is None or name not in entry["attributes"]:
            return self.accessor(index, count)
        if name not in self.meshes.get(entry["bufferView"], {}):
            self._unpack_meshes(next(names for names in _TOGETHER if name in names))
        values = self.meshes[entry["bufferView"]][name]
        if len(values) != count:
            raise ValueError(f"a Draco mesh of {len(values):,} vertices, where the file states {count:,}")
        return _scaled(values, self.document["accessors"][index])

    def corners(self, part: dict[str, Any]) -> Int[Array, " n"]:
        """The vertex indices of a primitive, which may be in a Draco mesh."""
        if entry := part.get("extensions", {}).get(DRACO):
            if "indices" not in self.meshes.get(entry["bufferView"], {}):
                self._unpack_meshes(_TOGETHER[1])
            return self.meshes[entry["bufferView"]]["indices"].reshape(-1).astype(np.int64)
        if "indices" not in part:
            return np.arange(self.document["accessors"][part["attributes"]["POSITION"]]["count"])
        count = self.document["accessors"][part["indices"]]["count"]
        return self.accessor(part["indices"], count)[:, 0].astype(np.int64)

    def _unpack_meshes(self, wanted: set[str]) -> None:
        """Unpack some attributes of all Draco meshes at once, because it starts a process."""
        parts: dict[int, dict[str, int]] = {}
        for mesh in self.document["meshes"]:
            for part in mesh["primitives"]:
                if entry := part.get("extensions", {}).get(DRACO):
                    ids = entry["attributes"] | {"indices": draco.INDICES}
                    parts[entry["bufferView"]] = {name: int(ids[name]) for name in sorted(wanted & ids.keys())}
        sent = [(self.view_bytes(index), ids) for index, ids in parts.items()]
        for index, found in zip(parts, draco.unpacked(sent, UNPACKED_BYTES), strict=True):
            self.meshes[index] = self.meshes.get(index, {}) | found

    def view_bytes(self, index: int) -> bytes:
        """The bytes of a view."""
        data, start, view = self._view(index)
        return bytes(memoryview(data)[start:][: view["byteLength"]])

    def accessor(self, index: int, count: int | None = None) -> Float[Array, "n c"]:
        """The first `count` elements of an accessor, or all. Raises ValueError: it has fewer, or is damaged."""
        accessor = self.document["accessors"][index]
        count = accessor["count"] if count is None else count
        if not 0 <= count <= accessor["count"]:
            raise ValueError(f"accessor {index} has a count that cannot be")
        if "bufferView" in accessor:
            values = self._elements(accessor, accessor["type"], count)
        elif "sparse" in accessor and count <= VERTICES:
            values = np.zeros((count, _WIDTHS[accessor["type"]]), np.dtype(TYPES[accessor["componentType"]]))
        else:
            raise ValueError(f"accessor {index} has no data")
        if sparse := accessor.get("sparse"):
            if not 0 <= sparse["count"] <= accessor["count"]:
                raise ValueError(f"accessor {index} has more sparse elements than elements")
            places = self._elements(sparse["indices"], "SCALAR", sparse["count"])[:, 0]
            filled = accessor | sparse["values"] | {"byteOffset": sparse["values"].get("byteOffset", 0)}
            values, here = values.copy(), places < count
            values[places[here]] = self._elements(filled, accessor["type"], sparse["count"])[here]
        return _scaled(values, accessor)

    def _elements(self, place: dict[str, Any], kind: str, count: int) -> Array:
        """`count` elements in a view, as they are stored."""
        data, begin, view = self._view(place["bufferView"])
        dtype, width = np.dtype(TYPES[place["componentType"]]), _WIDTHS[kind]
        start = begin + place.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * width)
        if start < 0 or stride < dtype.itemsize * width:
            raise ValueError("an accessor with an offset or stride that cannot be")
        return np.ndarray((count, width), dtype, data, offset=start, strides=(stride, dtype.itemsize))

    def _view(self, index: int) -> tuple[Any, int, dict[str, Any]]:
        """The bytes that hold a view, the index at which it begins in them, and its entry."""
        view = self.document["bufferViews"][index]
        packed = next((view["extensions"][name] for name in MESHOPT if name in view.get("extensions", {})), None)
        if packed is None:
            if view.get("buffer", 0) != 0:
                raise ValueError(f"view {index} is in a buffer without bytes")
            return self.data, view.get("byteOffset", 0), view
        if index not in self.views:
            size = int(packed["count"]) * int(packed["byteStride"])
            held = sum(map(len, self.views.values()))
            if min(packed["count"], packed["byteStride"]) < 1 or size + held > UNPACKED_BYTES:
                raise ValueError(f"compressed data of {size:,} bytes, and at most {UNPACKED_BYTES:,} are unpacked")
            import meshopt

            part = np.frombuffer(self.data, np.uint8, packed["byteLength"], packed.get("byteOffset", 0))
            how = packed["mode"], packed.get("filter", "NONE")
            self.views[index] = bytes(meshopt.decode_gltf_buffer(part, packed["count"], packed["byteStride"], *how))
        return self.views[index], 0, view | {"byteStride": packed["byteStride"]}


@contextmanager
def refusing_damage(path: Path) -> Iterator[None]:
    """Raise MotionError, or DependencyError for a missing package, in place of what a damaged document causes."""
    try:
        yield
    except _DAMAGE as error:
        raise MotionError(
            f"{path} does not keep to the glTF format ({type(error).__name__}: {str(error)[:120]}); export it again"
        ) from error
    except ModuleNotFoundError as error:
        raise DependencyError(
            f"{path} is compressed, which needs {error.name}: pip install 'echoavatar[gltf]'"
        ) from error


def read_chunks(path: Path) -> Gltf:
    """The document of a file and its bytes. Call it inside `refusing_damage`.

    Raises MotionError: the file or a part of it is missing, damaged, too large, no glTF, or outside its folder.
    """
    try:
        check_file(path, GLB_BYTES, MotionError)
        with path.open("rb", buffering=0) as file:  # a buffered file would copy the bytes
            head, length = file.read(20), GLTF_BYTES + 1
            if head.startswith(b"glTF"):
                *_, length, kind = struct.unpack("<4sIIII", head)
                if kind != 0x4E4F534A:
                    raise struct.error
            else:
                file.seek(0)
            text = decoded(file.read(min(length, GLTF_BYTES + 1)))[0].strip("\0 \t\r\n")
            if not text.startswith("{"):
                raise struct.error
            file.seek(28 + length)
            first = file.read()
        document = read_object(text, f"the JSON in {path}", most=GLTF_BYTES, error=MotionError)
        return _joined(path, _present(document) if "null" in text else document, first)
    except struct.error as error:
        raise MotionError(f"{path} is not binary glTF 2.0; export the character as .glb or .vrm") from error
    except OSError as error:
        raise MotionError(f"{path} cannot be read; check the name") from error


def _present(value: Any) -> Any:
    """A value of JSON without what some programs write as null."""
    if isinstance(value, dict):
        return {key: _present(inner) for key, inner in value.items() if inner is not None}
    return [_present(inner) for inner in value] if isinstance(value, list) else value


def _joined(path: Path, document: dict[str, Any], first: bytes) -> Gltf:
    """The document with all bytes in its first buffer; further buffers have no bytes, only a size for unpacked data."""
    buffers, images = document.get("buffers", []), document.get("images", [])
    outside = [*buffers[1:], *[entry for entry in (*buffers[:1], *images) if "uri" in entry]]
    if all(_is_empty(entry) for entry in outside):
        return Gltf(path, document, first)
    if len(buffers) + len(images) > FILE_PARTS:
        raise ValueError(f"{len(buffers) + len(images):,} parts, and at most {FILE_PARTS:,} are read")
    data, starts, kept = bytearray(), [], [{"byteLength": 0}]
    for index, entry in enumerate(buffers):
        if _is_empty(entry):
            kept.append(entry)
            starts.append((len(kept) - 1, 0))
        else:
            part = _bytes_of(path, entry["uri"], len(data)) if "uri" in entry else first if not index else b""
            starts.append((0, len(data)))
            data += memoryview(part)[: entry["byteLength"]]
            data += b"\0" * (-len(data) % 4)
    for view in document.get("bufferViews", []):
        for place in (view, *(view.get("extensions", {}).get(name, {}) for name in MESHOPT)):
            if "buffer" in place:
                place["buffer"], start = starts[place["buffer"]]
                place["byteOffset"] = place.get("byteOffset", 0) + start
    for image in images:
        if "uri" in image:
            part = _bytes_of(path, image.pop("uri"), len(data))
            kind = next((kind for head, kind in _PICTURES.items() if part.startswith(head)), "image/png")
            views = document.setdefault("bufferViews", [])
            image |= {"mimeType": kind, "bufferView": len(views)}
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(part)})
            data += part + b"\0" * (-len(part) % 4)
    kept[0]["byteLength"] = len(data)
    document["buffers"] = kept
    return Gltf(path, document, data)


def _is_empty(buffer: dict[str, Any]) -> bool:
    """Whether a buffer has no bytes, only a size for unpacked data (meshopt's fallback)."""
    return "uri" not in buffer and any(buffer.get("extensions", {}).get(name, {}).get("fallback") for name in MESHOPT)


def _bytes_of(path: Path, uri: str, held: int) -> bytes:
    """The bytes of a `data:` URI or of a file in the document's folder; `held` bytes have been read already."""
    head, _, text = uri.partition(",")
    if head[:5].lower() == "data:":
        return from_base64(text) if head.lower().endswith(";base64") else unquote_to_bytes(text)
    folder = path.parent.resolve()
    place = unquote_to_bytes(uri.replace("\\", "/")).decode()  # as Windows writes it
    part = Path(os.path.realpath(folder / place))
    if part.parent.is_relative_to(folder) and part.parent.is_dir() and not part.exists():  # Windows ignores case
        alike = (other for other in part.parent.iterdir() if other.name.lower() == part.name.lower())
        part = Path(os.path.realpath(next(alike, part)))
    if not part.is_relative_to(folder) or ":" in uri.split("/")[0]:
        raise MotionError(f"{path} refers to {uri!r}, which is outside its folder; export it as one .glb")
    try:
        check_file(part, GLB_BYTES - held, MotionError)
        return part.read_bytes()
    except OSError as error:
        raise MotionError(f"{path} refers to {uri!r}, which cannot be read; put it beside the file") from error


def _scaled(values: Array, accessor: dict[str, Any]) -> Float[Array, "n c"]:
    """Values as floats; normalised integers as the -1 to 1 that they stand for."""
    with np.errstate(invalid="ignore"):  # callers refuse values that are not finite
        found = values.astype(np.float64)
    if not accessor.get("normalized"):
        return found
    return np.maximum(found / np.iinfo(TYPES[accessor["componentType"]]).max, -1)
