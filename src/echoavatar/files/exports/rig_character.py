"""The user's own character (VRM or GLB) as a `Character`, which films draw like ours.

Its meshes are put into the rest pose of its rig once; from there every frame moves them with the bones. Films show the
base colours, with their pictures (PNG, JPEG, WebP) and alpha, but no toon shading, normal maps or swinging hair.
"""

import io
import logging
import re
from collections import defaultdict
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from echoavatar.errors import MotionError
from echoavatar.limits import CORNERS, MORPHED, PIXELS
from echoavatar.motion.formats.gltf_data import refusing_damage
from echoavatar.motion.formats.gltf_rig import GltfRig, Part, parts_of
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.retarget import PlainRig

from ..avatar.character import ARRAYS, Character, Material, Morphs, Textures
from .rig_face import face_on
from .target_rig import Rig

_log = logging.getLogger(__name__)
Array = np.ndarray
_Shapes = defaultdict[tuple[int, int], list[tuple[Array, ...]]]  # node and target: vertices, moves, turns
_SHOWN = re.compile(  # required extensions with which a film is complete
    "KHR_(mesh_quantization|draco_mesh_compression|meshopt_compression|texture_transform|texture_basisu|materials_unlit|"
    "materials_pbrSpecularGlossiness)|EXT_(meshopt_compression|texture_webp)|VRM.*"
)
_FARTHEST = 4096.0  # a picture repeats at most so often


def film_character(rig: Rig, face: Float[Array, "t 52"] | None, frames: int) -> tuple[Character, Float[Array, "t n"]]:
    """The character of a rig, and the weights of its blendshapes in each frame.

    One warning lists what a film cannot show of it.

    Raises MotionError: the rig is a skeleton without a mesh, or its file is damaged or too large.
    """
    if rig.gltf is None or not rig.has_mesh:
        raise MotionError(f"{rig.path} is a skeleton without a mesh to film: give a .vrm or .glb as --rig")
    with refusing_damage(rig.path), np.errstate(invalid="ignore", over="ignore"):  # checked below
        weights = {} if face is None else face_on(rig.path, rig.gltf.document, face)
        wanted = {node: np.flatnonzero(rows.any(0)) for node, rows in weights.items()}
        character, moved = _character(rig.gltf, rig.skeleton, wanted)
    curves = [weights[node][:, target] for node, target in moved]
    return character, np.stack(curves, 1) if curves else np.zeros((frames, 0), np.float32)


def _character(
    rig: GltfRig, skeleton: Skeleton, wanted: dict[int, Int[Array, " k"]]
) -> tuple[Character, list[tuple[int, int]]]:
    """The character, and the node and target of each of its shapes; those `wanted` of each node are read."""
    unturned = np.tile(np.eye(3), (skeleton.joints, 1, 1))
    columns: list[tuple[Array, ...]] = []
    shapes: _Shapes = defaultdict(list)
    paints, count, targets = _Paints(rig), 0, 0
    for part in parts_of(rig, PlainRig(skeleton, unturned), has_rigid=True):
        faces, material = _triangles(rig, part), paints.material(part)
        faces = faces[part.is_own[faces].all(1)]
        if not len(faces):
            continue
        used, local = np.unique(faces, return_inverse=True)
        local = local.reshape(-1, 3)
        if np.linalg.det(part.moves[part.joints[used[0], part.shares[used[0]].argmax()], :3, :3]) < 0:
            local = local[:, ::-1]
        places = part.moved(part.places[used], used)
        columns.append((
            places, _normals(rig, part, used, places, local), paints.colours(part)[used], paints.uvs(part)[used],
            np.full(len(used), material), part.owners[part.joints[used]], part.shares[used], local + count,
        ))  # fmt: skip
        if 3 * sum(len(column[-1]) for column in columns) > CORNERS:
            raise ValueError(f"meshes of more than {CORNERS // 3:,} triangles")
        for target in map(int, wanted.get(part.node, ())):
            targets += len(part.places)
            if targets > MORPHED:
                raise ValueError(f"morph targets of more than {MORPHED:,} vertices")
            at, *changes = _target(rig, part, used, target)
            shapes[part.node, target].append((at + count, *changes))
        count += len(used)
    if not count:
        raise MotionError(f"{rig.path}: none of its meshes hangs from its bones; export it with its skin weights")
    arrays = [np.concatenate(column) for column in zip(*columns, strict=True)]
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("vertices, normals or colours that are not finite")
    paints.tell()
    kinds = np.float32, np.float32, np.uint8, np.float32, np.uint16, np.uint16, np.float32, np.int32
    typed: dict[str, Any] = {name: array.astype(kind) for name, array, kind in zip(ARRAYS, arrays, kinds, strict=True)}
    face, palette = _morphs(shapes), tuple(paints.palette)
    mesh = Character(**typed, face=face, textures=paints.textures, palette=palette, skeleton=skeleton)
    return mesh, list(shapes)


def _triangles(rig: GltfRig, part: Part) -> Int[Array, "f 3"]:
    """The vertices of each triangle; lines and points have none."""
    mode, order = part.entry.get("mode", 4), rig.corners(part.entry)
    if len(order) and not 0 <= order.min() <= order.max() < len(part.places):
        raise ValueError("a triangle whose vertex does not exist")
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if mode not in (5, 6) or len(order) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == 6:
        return np.column_stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]])
    strip = np.column_stack([order[:-2], order[1:-1], order[2:]])
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip


def _normals(
    rig: GltfRig, part: Part, used: Int[Array, " v"], places: Float[Array, "v 3"], faces: Int[Array, "f 3"]
) -> Float[Array, "v 3"]:
    """Unit normals: the file's, or those of the triangles around a vertex."""
    if "NORMAL" in part.entry["attributes"]:
        stored = rig.attribute(part.entry, "NORMAL")
        normals = part.moved(stored[used], used, are_places=False)
    else:
        a, b, c = places[faces].transpose(1, 0, 2)
        normals = np.zeros_like(places)
        for corner in faces.T:
            np.add.at(normals, corner, np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


def _target(rig: GltfRig, part: Part, used: Int[Array, " v"], target: int) -> tuple[Array, Array, Array]:
    """The vertices that a morph target moves, as indices into `used`, their moves and the changes of their normals."""
    document, count = rig.document, len(part.places)
    stored = {} if target >= len(part.entry.get("targets", [])) else part.entry["targets"][target]
    changes = np.zeros((2, len(used), 3))
    for change, name in zip(changes, ("POSITION", "NORMAL"), strict=True):
        if name in stored and {"bufferView", "sparse"} & document["accessors"][stored[name]].keys():
            change[:] = rig.accessor(stored[name], count)[used]
    at = np.flatnonzero(changes.any((0, 2)))
    moves, turns = (part.moved(change[at], used[at], are_places=False) for change in changes)
    return at, moves, turns


def _morphs(shapes: _Shapes) -> Morphs:
    """The shapes, each joined from its primitives."""
    names = tuple(f"{node} {target}" for node, target in shapes)
    starts = np.cumsum([0, *(sum(len(part[0]) for part in parts) for parts in shapes.values())])
    parts = [part for parts in shapes.values() for part in parts] or [(np.zeros(0), *np.zeros((2, 0, 3)))]
    vertices, moves, turns = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Morphs(names, starts, vertices.astype(np.int64), moves.astype(np.float32), turns.astype(np.float32))


class _Paints:
    """Materials and pictures of a document."""

    def __init__(self, rig: GltfRig) -> None:
        self._rig, self._document = rig, rig.document
        self.palette: list[Material] = []
        self.textures: Textures = {}
        self._known: dict[int, int] = {}  # rows of the palette
        self._unseen: dict[str, str] = {}  # by name of a picture that is not shown: its kind

    def material(self, part: Part) -> int:
        """The palette's row for a primitive."""
        index = part.entry.get("material", -1)
        if index not in self._known:
            self._known[index] = len(self.palette)
            self.palette.append(self._made(index))
        return self._known[index]

    def _made(self, index: int) -> Material:
        entry, surface, base, factor = self._surface(index)
        mode, alpha, name = entry.get("alphaMode", "OPAQUE"), float(factor[3]), self._picture(base)
        roughness = float(surface.get("roughnessFactor", 1.0)) * (0.8 if "metallicRoughnessTexture" in surface else 1)
        cutoff = float(entry.get("alphaCutoff", 0.5)) if mode == "MASK" else 0.5
        is_cut = (mode == "MASK" and cutoff > 0) or mode == "BLEND"
        if is_cut and not name and alpha < 1:
            name = self._white()
        return Material(
            str(index), max(roughness, 0.06), name, bool(entry.get("doubleSided")), is_cut and mode == "MASK",
            is_sheer=mode == "BLEND", opacity=alpha * 0.5 / cutoff if is_cut else 1.0,
        )  # fmt: skip

    def _white(self) -> str:
        """The name of a white picture, for see-through materials that have none."""
        file = io.BytesIO()
        Image.new("RGBA", (1, 1), "white").save(file, "PNG")
        self.textures["white"] = file.getvalue()
        return "white"

    def _surface(self, index: int) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], list[float]]:
        """The entry of a material, its surface, the base colour's picture and its factor (linear RGBA)."""
        entry = self._document["materials"][index] if index >= 0 else {}
        if older := entry.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness"):
            return entry, {}, older.get("diffuseTexture", {}), older.get("diffuseFactor", [1, 1, 1, 1])
        surface = entry.get("pbrMetallicRoughness", {})
        return entry, surface, surface.get("baseColorTexture", {}), surface.get("baseColorFactor", [1, 1, 1, 1])

    def _picture(self, base: dict[str, Any]) -> str:
        """The name of a picture that can be drawn; "" for none."""
        if "index" not in base:
            return ""
        texture = self._document["textures"][base["index"]]
        more = texture.get("extensions", {})
        sources = [entry["source"] for entry in (texture, *more.values()) if "source" in entry]
        for source in sources:
            name = str(source)
            if name not in self.textures and name not in self._unseen:
                encoded = self._rig.view_bytes(self._document["images"][source]["bufferView"])
                if kind := _unreadable(encoded):
                    self._unseen[name] = kind
                else:
                    self.textures[name] = encoded
            if name in self.textures:
                return name
        return ""

    def uvs(self, part: Part) -> Float[Array, "v 2"]:
        """Coordinates on the base colour's picture, v downwards, at least 0."""
        _, _, base, _ = self._surface(part.entry.get("material", -1))
        moved = base.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{moved.get('texCoord', base.get('texCoord', 0))}"
        if name not in part.entry["attributes"]:
            return np.zeros((len(part.places), 2))
        uvs = self._rig.attribute(part.entry, name) * moved.get("scale", [1, 1])
        cos, sin = np.cos(moved.get("rotation", 0)), np.sin(moved.get("rotation", 0))
        uvs = uvs @ np.array([[cos, -sin], [sin, cos]]) + moved.get("offset", [0, 0])
        return np.asarray(np.clip(uvs - np.floor(uvs.min(0)), 0, _FARTHEST))  # a picture repeats

    def colours(self, part: Part) -> Float[Array, "v 3"]:
        """The sRGB colour of each vertex, 0 to 255: the material's factor times the vertex's own colour."""
        *_, factor = self._surface(part.entry.get("material", -1))
        linear = np.tile(np.array(factor[:3], np.float64), (len(part.places), 1))
        if "COLOR_0" in part.entry["attributes"]:
            linear *= self._rig.attribute(part.entry, "COLOR_0")[:, :3]
        linear = linear.clip(0, 1)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return np.asarray(np.round(255 * srgb))

    def tell(self) -> None:
        """Say in one line what is not shown."""
        kinds = ", ".join(sorted(set(self._unseen.values())))
        parts = [f"{len(self._unseen)} pictures ({kinds}; PNG, JPEG and WebP are shown)"] if self._unseen else []
        parts += [name for name in self._document.get("extensionsRequired", []) if not _SHOWN.fullmatch(name)]
        if parts:
            _log.warning("%s: a film does not show its %s", self._rig.path, ", ".join(map(str, parts)))


def _unreadable(encoded: bytes) -> str:
    """Why a picture cannot be shown; "" if it can."""
    try:
        with Image.open(io.BytesIO(encoded), formats=("JPEG", "PNG", "WEBP")) as picture:
            return "" if picture.width * picture.height <= PIXELS else f"{picture.width}x{picture.height}"
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return "KTX2" if encoded[1:7] == b"KTX 20" else "an unknown kind"
