"""How the files of `hostile_files` are made."""

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import soundfile
from tests.files.exports.bodies import long_armed
from tests.motion.formats.repacked import Collected, in_parts, taken_apart, with_draco, with_meshopt

from echoavatar.files.avatar.character import FOLDER, load_character
from echoavatar.files.avatar.gltf import container
from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion

Change = Callable[[dict[str, Any]], object]
RIG = "rig FILE -o OUT.json"
EXPORT = "export TAKE -o OUT.glb --rig FILE"
ANIMATE = "animate none.wav -o OUT.glb --rig FILE"
AS_TAKE = "export FILE -o OUT.glb"
LIST, ADD = "actions list --model FOLDER", "actions add salute FILE --model FOLDER"


class File(NamedTuple):
    """How a file is made, and what reads it; `ending` is that of its name."""

    make: Callable[[Path], object]
    read: str | Callable[[Path], object]
    ending: str = "glb"
    is_slow: bool = False


def changed(change: Change, data: bytes, more: bytes = b"") -> bytes:
    """A GLB with its JSON changed, and bytes added to its buffer."""
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    change(document)
    return container(document, data[28 + length :] + more)


def glb(change: Change, read: str = RIG, *, of: Callable[[], bytes] = long_armed, more: int = 0) -> File:
    """A character whose JSON is changed, with `more` zeros at the end of its buffer."""
    return File(lambda path: path.write_bytes(changed(change, of(), bytes(more))), read)


def raw(text: bytes, read: str = RIG) -> File:
    """A GLB with this JSON."""
    return File(
        lambda path: path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 0, len(text), 0x4E4F534A) + text), read
    )


def plain(data: Callable[[], bytes | str], read: str | Callable[[Path], object], ending: str) -> File:
    """A file of these bytes or this text."""

    def make(path: Path) -> None:
        made = data()
        path.write_bytes(made.encode() if isinstance(made, str) else made)

    return File(make, read, ending)


def smpl(**stored: Callable[[], np.ndarray]) -> File:
    """An NPZ of SMPL motion."""

    def make(path: Path) -> None:
        np.savez_compressed(path, **{name: array() for name, array in stored.items()})

    return File(make, AS_TAKE, "npz")


def arrays(read: str | Callable[[Path], object] = AS_TAKE, **stored: Callable[[], np.ndarray]) -> File:
    """An NPZ of a take, some of whose arrays are others."""

    def make(path: Path) -> None:
        still = np.tile(np.float32([1, 0, 0, 0]), (4, HUMANOID.joints, 1))
        write_npz(path, Motion(HUMANOID, still, np.zeros((4, 3), np.float32), 30.0))
        with np.load(path) as taken:
            made = dict(taken)
        np.savez_compressed(path, **made | {name: array() for name, array in stored.items()})

    return File(make, read, "npz")


def skinned(document: dict[str, Any]) -> dict[str, Any]:
    """The node that draws the body."""
    return next(node for node in document["nodes"] if "skin" in node)


def spread(document: dict[str, Any], count: int, kinds: dict[str, str] | None = None) -> None:
    """Let the body have `count` vertices, all of them zeros at the end of the buffer."""
    held = document["meshes"][0]["primitives"][0]["attributes"]
    start = document["buffers"][0]["byteLength"]
    document["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": 12 * count})
    for name, entry in (("POSITION", 5126), ("JOINTS_0", 5121), ("WEIGHTS_0", 5121)):
        accessor = document["accessors"][held[name]]
        accessor.update(bufferView=len(document["bufferViews"]) - 1, byteOffset=0, componentType=entry, count=count)
        accessor["type"] = (kinds or {}).get(name, accessor["type"])


def unpacking(count: int, stride: int) -> bytes:
    """A body whose compressed places state, or are, this many rows of zeros."""
    import meshopt

    document, binary = taken_apart(with_meshopt(long_armed()))
    rows = np.zeros((min(count, 1 << 20), stride), np.uint8)
    stored = Collected()
    stored.data = bytearray(binary)
    place = stored.add(meshopt.encode_gltf_buffer(rows, "ATTRIBUTES"))
    index = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    view = document["bufferViews"][document["accessors"][index]["bufferView"]]
    view["extensions"]["EXT_meshopt_compression"] |= place | {"count": count, "byteStride": stride}
    document["accessors"][index]["count"] = count
    document["buffers"][0]["byteLength"] = len(stored.data)
    return container(document, stored.data)


def draco_of(count: int, columns: int, *, places: int = 1 << 24) -> bytes:
    """A body whose Draco mesh is this many vertices, with attributes of so many zeros beside them."""
    import DracoPy

    document, binary = taken_apart(with_draco(long_armed()))
    points = np.zeros((count, 3), np.float32)
    points[:, 0] = np.arange(count) % places
    beside = {number: np.zeros((count, columns), np.uint32) for number in (5, 7)}
    stored = Collected()
    stored.data = bytearray(binary)
    data = DracoPy.encode(points, None, generic_attributes=beside, quantization_bits=24)
    part = document["meshes"][0]["primitives"][0]
    entry = part["extensions"]["KHR_draco_mesh_compression"]
    entry["attributes"] = {"POSITION": 8, "JOINTS_0": 5, "WEIGHTS_0": 7}
    document["bufferViews"][entry["bufferView"]] = stored.add(data) | {"buffer": 0}
    for index in part["attributes"].values():
        document["accessors"][index]["count"] = count
    document["buffers"][0]["byteLength"] = len(stored.data)
    return container(document, stored.data)


def parted(change: Change) -> File:
    """A `.gltf` and its parts, whose JSON is changed."""

    def make(path: Path) -> None:
        made = in_parts(long_armed(), path.parent / "in")
        document = json.loads(made.read_text("utf-8"))
        change(document)
        (path.parent / "in" / "my parts").rename(path.parent / "my parts")
        (path.parent / "in" / "skin#1.png").rename(path.parent / "skin#1.png")
        path.write_text(json.dumps(document), "utf-8")

    return File(make, RIG, "gltf")


def under_hips(document: dict[str, Any], count: int) -> None:
    """Further joints below the hips."""
    hips = next(node for node in document["nodes"] if node.get("name", "").endswith(("Hips", "_hips")))
    first = len(document["nodes"])
    document["nodes"] += [{} for _ in range(count)]
    hips["children"] += range(first, first + count)
    document["skins"][0]["joints"] += range(first, first + count)
    document["skins"][0].pop("inverseBindMatrices")


def binds_of_nodes(document: dict[str, Any], nodes: int, binds: int) -> None:
    """VRM 0.x: each bind names a mesh, and each node may use it."""
    document["nodes"] += [{"mesh": 1}] * nodes
    group = {"presetName": "a", "binds": [{"mesh": 1, "index": 0, "weight": 1}] * binds}
    document["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"] = [group]
    for part in document["meshes"][1]["primitives"]:
        part["targets"] = part["targets"][:1]


def expressions(document: dict[str, Any], count: int, binds: int) -> None:
    """VRM 1.0: many expressions, each of a size that one may have."""
    bones = {bone: {"node": joint} for joint, bone in enumerate(HUMANOID.names)}
    bind = {"node": len(document["nodes"]) - 1, "index": 0, "weight": 0}
    preset = {f"e{number}": {"morphTargetBinds": [bind] * binds} for number in range(count)}
    document["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": bones}, "expressions": {"preset": preset}}}


def bvh(
    rows: list[str], *, joint: str = "", name: str = "Hips", channels: str = "1 Xposition", time: str = "0.03"
) -> str:
    """A root with one channel, further joints, and the frames of these rows."""
    head = ["HIERARCHY", f"ROOT {name}", "{", "OFFSET 0 1 0", f"CHANNELS {channels}", joint, "End Site", "{"]
    head += ["OFFSET 0 1 0", "}", "}", "MOTION", f"Frames: {len(rows)}", f"Frame Time: {time}"]
    return "\n".join([*head, *rows, ""])


def joints(count: int, channels: str) -> str:
    """Joints side by side."""
    return "\n".join(f"JOINT j{number}\n{{\nOFFSET 0 0 0\nCHANNELS {channels}\n}}" for number in range(count))


def png(width: int, height: int, *, rows: int = 200) -> np.ndarray:
    """A grey PNG of zeros, of which only so many rows are there."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(width + 1)) for _ in range(min(height, rows))) if width < 1 << 20 else b""
    parts = [
        chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        chunk(b"IDAT", data + packer.flush()),
    ]
    return np.frombuffer(b"\x89PNG\r\n\x1a\n" + b"".join(parts) + chunk(b"IEND", b""), np.uint8)


def picture(width: int, height: int) -> File:
    """A character with this picture."""

    def make(path: Path) -> None:
        with np.load(FOLDER / "maya.npz") as stored:
            np.savez(path, **dict(stored) | {"texture_atlas": png(width, height)})

    return File(make, lambda path: load_character(path).texels, "npz")


def library(*rows: dict[str, Any], times: int = 1) -> File:
    """An `actions.json` of these actions in a bundle."""
    whole = {"name": "wave", "about": "to wave", "hold": [0, 1], "codes": [0, 0, 0, 0], "guides": True}
    return plain(lambda: json.dumps({"version": 2, "actions": [whole | row for row in rows] * times}), LIST, "json")


def mp3_with_covers(count: int) -> bytes:
    """A second of sound behind pictures of 12,000 by 12,000 pixels, each of which takes 144 MB when it is decoded."""

    def length(data: bytes) -> bytes:
        return bytes(len(data) >> shift & 127 for shift in (21, 14, 7, 0))

    body = b"\0image/png\0\x03\0" + png(12_000, 12_000, rows=12_000).tobytes()
    covers = (b"APIC" + length(body) + b"\0\0" + body) * count
    sound = io.BytesIO()
    soundfile.write(sound, 0.2 * np.sin(np.arange(24_000) / 10), 24_000, format="MP3")
    return b"ID3\x04\0\0" + length(covers) + covers + sound.getvalue()


def wav(channels: int, rate: int, *, stated: int = 4_000) -> bytes:
    """A WAV of 4,000 bytes whose header says something else."""
    head = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, channels, rate, rate & 0xFFFF, channels * 2 & 0xFFFF, 16)
    return b"RIFF" + struct.pack("<I", 0xFFFFFFFF) + b"WAVE" + head + b"data" + struct.pack("<I", stated) + bytes(4_000)
