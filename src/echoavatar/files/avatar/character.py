"""A character as data: a skinned mesh and what is painted on it. The shipped ones are made by `tools/character`.

Its pictures are encoded as in its file, and decoded with their reductions (mip levels) for the rasteriser. Its morph
targets say what each blendshape adds to the vertices of the neutral face, kept sparse.
"""

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Integer, UInt8
from numpy.typing import ArrayLike

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.limits import PIXELS
from echoavatar.motion.formats.tables import NPZ_ERRORS, arrays_of
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.nn.kernels import kernel

NAMES = ("atlas", "hair", "outfit")  # colours, which the rasteriser draws too
# Details are written into glTF; films read the roughness of skin alone.
DETAILS = ("knit_normal", "twill_normal", "skin_normal", "skin_roughness")


# Encoded pictures by name: JPEG, PNG or WebP. Of the shipped ones `hair` has alpha; normal maps of cloth repeat;
# those of skin have the atlas's coordinates.
Textures = dict[str, bytes]


class Texels(NamedTuple):
    """All decoded pictures in one list, RGBA in sRGB; `table` (picture, level) holds start, width, height."""

    values: UInt8[np.ndarray, "n 4"]
    table: Int[np.ndarray, "p l 3"]


REDUCTIONS = 6
TEXELS = 1 << 25  # of a character's pictures; 2048 x 2048 for each of eight


def _pixels(encoded: bytes, mode: str) -> UInt8[np.ndarray, "h w *c"]:
    """The pixels of a JPEG, PNG or WebP in a mode of Pillow.

    Raises CheckpointError: the picture is damaged, or has more pixels than `PIXELS`.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(encoded), formats=("JPEG", "PNG", "WEBP")) as picture:
            if picture.width * picture.height > PIXELS:
                raise CheckpointError(
                    f"a picture of {picture.width} x {picture.height} pixels, and at most {PIXELS:,} are read"
                )
            return np.asarray(picture.convert(mode))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise CheckpointError(f"a picture of the character cannot be read ({error}); make it again") from error


def decoded(pictures: Sequence[tuple[bytes, float]]) -> Texels:
    """Decode pictures, each with a factor on its alpha, and halve each `REDUCTIONS` - 1 times.

    Many large ones are made smaller first, so that all together have at most `TEXELS`.
    """
    lists, table, start = [np.zeros((0, 4), np.uint8)], np.zeros((len(pictures), REDUCTIONS, 3), np.int64), 0
    side = 2 ** int(math.log2(math.sqrt(TEXELS / max(1, len(pictures)))))
    for row, (encoded, opacity) in enumerate(pictures):
        level = _pixels(encoded, "RGBA")
        while max(level.shape[:2]) > side:
            level = _halved(level)
        if opacity != 1:
            level = np.dstack([level[..., :3], np.clip(level[..., 3] * opacity, 0, 255).astype(np.uint8)])
        for column in range(REDUCTIONS):
            height, width = level.shape[:2]
            table[row, column] = start, width, height
            lists.append(level.reshape(-1, 4))
            start += width * height
            level = _halved(level)
    return Texels(np.ascontiguousarray(np.concatenate(lists)), table)


def _halved(level: UInt8[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "i j 4"]:
    """Half as wide and high."""
    if min(level.shape[:2]) < 2:
        return level
    half = np.empty((level.shape[0] // 2, level.shape[1] // 2, 4), np.uint8)
    reduced(level, half)
    return half


@kernel()
def reduced(level, half):  # type: ignore[no-untyped-def]
    """Means of two by two texels. Alpha counts as weight, and is raised so that cut-out strands do not thin out."""
    zero, one, raised = np.float32(0), np.float32(1), np.float32(1.12)
    for row in range(half.shape[0]):
        for column in range(half.shape[1]):
            alphas, red, green, blue = zero, zero, zero, zero
            for dy in range(2):
                for dx in range(2):
                    alphas += np.float32(level[2 * row + dy, 2 * column + dx, 3])
            for dy in range(2):
                for dx in range(2):
                    texel = level[2 * row + dy, 2 * column + dx]
                    share = np.float32(texel[3]) if alphas > zero else one
                    red += share * np.float32(texel[0])
                    green += share * np.float32(texel[1])
                    blue += share * np.float32(texel[2])
            total = alphas if alphas > zero else np.float32(4)
            half[row, column, 0], half[row, column, 1], half[row, column, 2] = red / total, green / total, blue / total
            half[row, column, 3] = min(alphas / np.float32(4) * raised, np.float32(255))


def looked_up(
    texels: Texels, picture: Int[np.ndarray, " v"], uvs: Float[np.ndarray, "v 2"]
) -> Float[np.ndarray, "v 3"]:
    """The sRGB colour (0 to 1) at each place of its picture, from the third level; picture -1 is white."""
    out = np.ones((len(uvs), 3), np.float32)
    for row, (start, width, height) in enumerate(texels.table[:, 2]):
        here = picture == row
        x = (uvs[here, 0] % 1 * width).astype(int).clip(0, width - 1)
        y = (uvs[here, 1] % 1 * height).astype(int).clip(0, height - 1)
        out[here] = texels.values[start + y * width + x, :3] / np.float32(255)
    return out


def grey_at(encoded: bytes, uvs: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, " v"]:
    """The value (0 to 1) of a grey picture that does not repeat, at each place."""
    picture = _pixels(encoded, "L")
    size = np.array(picture.shape[::-1])
    x, y = (uvs * size).astype(int).clip(0, size - 1).T
    return np.asarray(picture[y, x] / np.float32(255))


MOVE_UNIT = 2e-6  # metres; how moves are stored
TURN_UNIT = 1 / 64  # how changes of normals are stored


@dataclass(frozen=True)
class Morphs:
    """Shapes on the first `reach` vertices of a mesh; entries of shape i are starts[i]..starts[i + 1].

    Attributes:
        names: of the shapes, in order.
        starts: (n + 1,) borders between the shapes' entries.
        vertices: (m,) the vertex of each entry, ascending within a shape.
        moves: (m, 3) metres at a weight of 1.
        turns: (m, 3) change of the normal at a weight of 1, before normals are made unit again.
    """

    names: tuple[str, ...]
    starts: Int[np.ndarray, " n1"]
    vertices: Int[np.ndarray, " m"]
    moves: Float[np.ndarray, "m 3"]
    turns: Float[np.ndarray, "m 3"]

    @cached_property
    def reach(self) -> int:
        """All moving vertices are before this one."""
        return int(self.vertices.max(initial=-1)) + 1

    def part(self, index: int) -> slice:
        """The entries of one shape."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))

    def on(
        self, used: Int[np.ndarray, " u"]
    ) -> Iterator[tuple[str, Int[np.ndarray, " k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]]:
        """Each shape on a part of the mesh: its name, and its vertices as indices into `used`, moves and turns."""
        place = np.full(max(self.reach, int(used.max()) + 1), -1)
        place[used] = np.arange(len(used))
        for index, name in enumerate(self.names):
            part = self.part(index)
            at = place[self.vertices[part]]
            here = at >= 0
            yield name, at[here], self.moves[part][here], self.turns[part][here]

    @classmethod
    def of_arrays(cls, stored: Mapping[str, np.ndarray]) -> "Morphs":
        """The shapes of a character's npz."""
        return cls(
            tuple(str(name) for name in stored["face_names"]),
            stored["face_starts"].astype(np.int64),
            stored["face_vertices"].astype(np.int64),
            stored["face_moves"].astype(np.float32) * np.float32(MOVE_UNIT),
            stored["face_turns"].astype(np.float32) * np.float32(TURN_UNIT),
        )


def checked_face(curves: ArrayLike, frames: int, shapes: int = 52) -> Float[np.ndarray, "t n"]:
    """Curves as float32, clipped to 0..1; raises `MotionError` when they do not fit motion or character."""
    face = np.asarray(curves, np.float32)
    if face.shape != (frames, shapes):
        raise MotionError(f"the face has shape {face.shape}; {frames} frames take ({frames}, {shapes})")
    if not np.isfinite(face).all():
        raise MotionError("the face holds values that are not finite; repair it before export")
    return np.clip(face, 0, 1)


@kernel(fastmath=True)
def added(weights, starts, vertices, moves, turns, positions, normals, reach):  # type: ignore[no-untyped-def]
    """Add the shapes with weights (n) to `positions` and `normals` (v, 3), and make the first `reach` normals unit."""
    for shape in range(weights.shape[0]):
        weight = np.float32(weights[shape])
        if weight != 0:
            for entry in range(starts[shape], starts[shape + 1]):
                v = vertices[entry]
                for i in range(3):
                    positions[v, i] += weight * moves[entry, i]
                    normals[v, i] += weight * turns[entry, i]
    for v in range(reach):
        length = normals[v, 0] ** 2 + normals[v, 1] ** 2 + normals[v, 2] ** 2
        scale = np.float32(1.0) / max(np.sqrt(length), np.float32(1e-9))
        for i in range(3):
            normals[v, i] *= scale


HEAD_M = 0.1865  # from the joint of Maya's head to its top; Theo's is 0.1945, Amara's 0.1855
CHARACTERS = ("maya", "theo", "amara")
LEVELS = 3  # of detail: NAME.lod0.glb has about 40,000 triangles, NAME.lod1.glb 15,000, NAME.lod2.glb 6,000
FOLDER = Path(str(files("echoavatar"))) / "assets" / "characters"
UV_UNITS = 8192
PLACE_UNIT = 2.0**-14  # metres; how places are stored


class Material(NamedTuple):
    """How a surface reflects light. Its colour is that of its picture times those of the vertices.

    A cutout is drawn where the picture's alpha times `opacity` is a half or more; a sheer material shows through as far
    as that product is below 1.
    """

    name: str
    roughness: float
    picture: str = ""
    is_two_sided: bool = False
    is_cutout: bool = False
    relief: str = ""  # a normal map
    repeats: tuple[float, float] = (1.0, 1.0)  # how often it repeats across and down the picture
    roughness_picture: str = ""
    is_sheer: bool = False
    opacity: float = 1.0


MATERIALS = (
    Material("skin", 0.62, "atlas", relief="skin_normal", roughness_picture="skin_roughness"),
    Material("eye", 0.06, "atlas"),
    Material("mouth", 0.22, "atlas"),
    Material("lash", 0.80, is_two_sided=True),
    Material("hair", 0.80, "hair", is_two_sided=True, is_cutout=True, is_sheer=True),
    Material("cloth", 0.92, "outfit", is_two_sided=True, relief="knit_normal", repeats=(21, 24)),
    Material("trousers", 0.88, "outfit", relief="twill_normal", repeats=(26, 42)),
    Material("shoe", 0.60, "outfit"),
    Material("sole", 0.70),
)


@dataclass(frozen=True)
class Character:
    """A skinned mesh in the rest pose of its skeleton. Triangles are counter-clockwise.

    `joints` index `BONES` of a shipped character, or the joints of the skeleton of another one.
    """

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    colours: UInt8[np.ndarray, "v 3"]  # sRGB; a factor on the picture
    uvs: Float[np.ndarray, "v 2"]  # v downwards; may leave 0..1 where the picture repeats
    materials: Integer[np.ndarray, " v"]  # index into `palette`
    joints: Integer[np.ndarray, "v 4"]
    weights: Float[np.ndarray, "v 4"]  # rows sum to 1
    triangles: Int[np.ndarray, "f 3"]
    face: Morphs  # blendshapes of the first vertices
    textures: Textures
    palette: tuple[Material, ...] = MATERIALS
    skeleton: Skeleton = HUMANOID
    outfits: tuple[str, ...] = ()  # pictures: see `outfit_picture`

    def wearing(self, outfit: str) -> "Character":
        """The same person in another outfit, the only one; raises CheckpointError: there is none of this name."""
        if outfit not in self.outfits:
            raise CheckpointError(f"there is no outfit {outfit!r}; choose from {', '.join(self.outfits) or 'none'}")
        worn = self.textures[outfit_picture(self.outfits.index(outfit))]
        others = {outfit_picture(i) for i in range(len(self.outfits))}
        textures = {name: encoded for name, encoded in self.textures.items() if name not in others} | {"outfit": worn}
        return replace(self, textures=textures, outfits=(outfit,))

    @property
    def head(self) -> int:
        """The joint of the head."""
        return self.skeleton.config.vrm["head"]

    @property
    def sizes(self) -> tuple[float, float]:
        """The height of the body, and that of the head above its joint, each over that of ours."""
        if self.skeleton is HUMANOID:
            return 1.0, 1.0
        ours = HUMANOID.rest_positions[HUMANOID.config.vrm["head"], 1]
        height = float(self.skeleton.rest_positions[self.head, 1] / ours)
        joints, corners = self.boxes
        return height, float(corners[joints == self.head, :, 1].max(initial=0)) / HEAD_M or height

    @cached_property
    def boxes(self) -> tuple[Int[np.ndarray, " b"], Float[np.ndarray, "b 8 3"]]:
        """The joints with vertices, and the corners of the box around each one's vertices, from the joint, metres."""
        owners = self.joints[np.arange(len(self.joints)), self.weights.argmax(1)]
        joints = np.unique(owners[owners < self.skeleton.joints])
        corners = np.empty((len(joints), 8, 3))
        for box, joint in zip(corners, joints, strict=True):
            held = self.positions[owners == joint] - self.skeleton.rest_positions[joint]
            box[:] = list(product(*zip(held.min(0), held.max(0), strict=True)))
        return joints, corners

    @cached_property
    def pictures(self) -> list[tuple[str, float]]:
        """The pictures that are drawn: the name in `textures`, and a factor on alpha."""
        return list(dict.fromkeys((m.picture, m.opacity) for m in self.palette if m.picture))

    @cached_property
    def texels(self) -> tuple[Texels, Int[np.ndarray, " m"]]:
        """The decoded pictures, and the row of each material's; -1: none."""
        rows = [self.pictures.index((m.picture, m.opacity)) if m.picture else -1 for m in self.palette]
        return decoded([(self.textures[name], opacity) for name, opacity in self.pictures]), np.array(rows, np.int32)

    def flat_colours(self) -> Float[np.ndarray, "v 3"]:
        """The sRGB colour of each vertex, 0 to 1, for files without pictures."""
        texels, rows = self.texels
        return looked_up(texels, rows[self.materials], self.uvs) * (self.colours / np.float32(255))

    def with_face(self, weights: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
        """Positions and unit normals in the rest pose with an expression; weights are in the order of `face.names`."""
        positions, normals, face = self.positions.copy(), self.normals.copy(), self.face
        strengths = np.asarray(weights, np.float32)
        added(strengths, face.starts, face.vertices, face.moves, face.turns, positions, normals, face.reach)
        return positions, normals


def outfit_picture(number: int) -> str:
    """The name of an outfit's picture."""
    return f"outfit_{number}" if number else "outfit"


def picture_names(outfits: int) -> list[str]:
    """The names of the pictures of a shipped character with so many outfits."""
    return [*NAMES, *DETAILS, *map(outfit_picture, range(1, outfits))]


ARRAYS = ("positions", "normals", "colours", "uvs", "materials", "joints", "weights", "triangles")


def load_character(path: Path | str | None = None) -> Character:
    """Read a character file, or a shipped one by its name (None: the first of `CHARACTERS`).

    `NAME/OUTFIT` is a shipped one in one of its `outfits`. Raises CheckpointError: the file is damaged, or no character
    or outfit has this name.
    """
    if path is None or isinstance(path, str):
        name, _, outfit = (path or CHARACTERS[0]).partition("/")
        whole = load_character(_shipped_file(name, "npz"))
        return whole.wearing(outfit) if outfit else whole
    try:
        stored = arrays_of(path, CheckpointError)
        raw: dict[str, Any] = {name: stored[name] for name in ARRAYS}
        raw["outfits"] = tuple(str(name) for name in stored["outfits"])
        names = picture_names(len(raw["outfits"]))
        raw["textures"] = {name: stored[f"texture_{name}"].tobytes() for name in names}
        raw["face"] = Morphs.of_arrays(stored)
    except NPZ_ERRORS as error:
        raise CheckpointError(f"{path} is not a character ({error}); make it again with tools/character") from error
    normals, weights = raw["normals"].astype(np.float32), raw["weights"].astype(np.float32)
    raw["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    raw["weights"] = weights / weights.sum(1, keepdims=True)
    raw["triangles"] = raw["triangles"].astype(np.int32)
    raw["positions"] = raw["positions"].astype(np.float32) * np.float32(PLACE_UNIT)
    raw["uvs"] = (raw["uvs"] / UV_UNITS).astype(np.float32)
    return Character(**raw)


def level_file(name: str, level: int) -> Path:
    """The GLB of a shipped character at a level of detail: meshopt compression, WebP pictures.

    Raises CheckpointError: no character has this name, or there is no such level.
    """
    if not 0 <= level < LEVELS:
        raise CheckpointError(f"there is no level of detail {level}; choose from 0 (finest) to {LEVELS - 1}")
    return _shipped_file(name, f"lod{level}.glb")


def _shipped_file(name: str, suffix: str) -> Path:
    if name not in CHARACTERS:
        raise CheckpointError(f"there is no character {name!r}; choose from {', '.join(CHARACTERS)}, or give a file")
    return FOLDER / f"{name}.{suffix}"
