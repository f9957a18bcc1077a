"""VRM 1.0 files of the people: `python -m echoavatar_character.vrm [NAME ...]` writes them into build/vrm.

Each is the shipped NAME.npz at level of detail 0 with VRM's humanoid, expressions, look-at, first person and licence.
The 52 ARKit curves are custom expressions by their own names; VRM's presets are mixed from them. Hair that hangs has
spring bones. The files hold plain PNG, JPEG and floats, because few VRM readers know mesh compression.
"""

import argparse
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from echoavatar.files.avatar import CHARACTERS, MATERIALS, Character, load_character
from echoavatar.files.avatar.gltf import BODY_NODE, FACE_NODE, HALFWAY_NODES, Buffer, character_document, packed
from echoavatar.files.avatar.halfway import BONES, REST, SOURCES
from echoavatar.files.avatar.render import Camera, Paint
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.expression import MOODS
from echoavatar.motion.kinematics import HUMANOID

from .eyes import ACROSS, UPWARDS
from .levels import simplified
from .person import PEOPLE
from .pose import DOWN
from .sheets import shot

LICENCE = "https://vrm.dev/licenses/1.0/"
META = {
    "version": "1.0",
    "authors": ["The EchoAvatar developers"],
    "copyrightInformation": "Copyright The EchoAvatar developers; Apache License 2.0",
    "thirdPartyLicenses": "MakeHuman base mesh, targets, masks and weights, and face units by Mika Suominen: CC0 1.0",
    "otherLicenseUrl": "https://www.apache.org/licenses/LICENSE-2.0",
    "licenseUrl": LICENCE,
    "avatarPermission": "everyone",
    "commercialUsage": "corporation",
    "creditNotation": "unnecessary",
    "allowRedistribution": True,
    "modification": "allowModificationRedistribution",
}
VOWELS: Mapping[str, Mapping[str, float]] = {  # names without a side stand for both
    "aa": {"jawOpen": 0.5, "mouthLowerDown": 0.25, "mouthUpperUp": 0.15},
    "ih": {"jawOpen": 0.16, "mouthStretch": 0.35, "mouthLowerDown": 0.25, "mouthUpperUp": 0.1},
    "ou": {"jawOpen": 0.12, "mouthPucker": 0.75, "mouthFunnel": 0.2},
    "ee": {"jawOpen": 0.22, "mouthSmile": 0.3, "mouthStretch": 0.3, "mouthLowerDown": 0.3},
    "oh": {"jawOpen": 0.34, "mouthFunnel": 0.6, "mouthPucker": 0.2},
}
EYES: Mapping[str, Mapping[str, float]] = {
    "blink": {"eyeBlink": 1.0},
    "blinkLeft": {"eyeBlinkLeft": 1.0},
    "blinkRight": {"eyeBlinkRight": 1.0},
    "lookUp": {"eyeLookUp": 1.0},
    "lookDown": {"eyeLookDown": 1.0},
    "lookLeft": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    "lookRight": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
}
FEELINGS: Mapping[str, Mapping[str, float]] = {
    "relaxed": {"mouthSmile": 0.25, "eyeBlink": 0.15, "cheekSquint": 0.15},
    "surprised": {"eyeWide": 0.8, "browOuterUp": 0.8, "browInnerUp": 0.7, "jawOpen": 0.3},
}
OF_MOODS = ("happy", "angry", "sad")
HANGING = {"bob"}  # styles of hair with spring bones
CHAINS, LINKS = 12, 3  # chains around the head, links from the ear to the ends
LEAST_SHARE = 0.01  # of a vertex; a bone of less is left out
SWING_FROM = 0.045  # metres above the head's joint, where hair begins to swing
FACE_HALF = np.radians(35)  # to each side of the front no hair hangs


Chain = Float[np.ndarray, "k 3"]  # places of spring bones, from the root to the tail


def _binds(curves: Mapping[str, float]) -> dict[str, Any]:
    """An expression that moves the face's curves; names without a side stand for both."""
    found = {}
    for name, weight in curves.items():
        for each in (name, f"{name}Left", f"{name}Right"):
            if each in ARKIT_NAMES:
                found[ARKIT_NAMES.index(each)] = weight
    binds = [{"node": FACE_NODE, "index": index, "weight": weight} for index, weight in sorted(found.items())]
    return {"morphTargetBinds": binds, "isBinary": False}


def expressions() -> dict[str, Any]:
    """VRM's presets, and the 52 curves by their ARKit names."""
    preset: dict[str, Any] = {"neutral": _binds({})}
    for name in OF_MOODS:
        row = MOODS[name]
        mood = {curve: round(float(row[i]), 3) for i, curve in enumerate(ARKIT_NAMES) if row[i] > 0}
        preset[name] = _binds(mood) | {"overrideMouth": "blend"}
    preset |= {name: _binds(curves) for name, curves in {**FEELINGS, **VOWELS, **EYES}.items()}
    preset["surprised"]["overrideMouth"] = "blend"
    return {"preset": preset, "custom": {name: _binds({name: 1.0}) for name in ARKIT_NAMES}}


def pack_vrm(character: Character, name: str, *, hangs: bool = False) -> bytes:
    """The file's bytes. `hangs` gives the hair spring bones.

    The character's curves must be in the order of `ARKIT_NAMES`.
    """
    chains = hair_chains(character) if hangs else []
    document, buffer = character_document(with_chains(character, chains))
    document["images"].append(_portrait(character, name, buffer))
    document["extensionsUsed"] += ["VRMC_vrm", "VRMC_node_constraint"]
    _constrain(document["nodes"])
    own = {"VRMC_vrm": _humanoid(character, name, thumbnail=len(document["images"]) - 1)}
    document["extensions"] = document.get("extensions", {}) | own  # outfits stand there
    if chains:
        document["extensionsUsed"].append("VRMC_springBone")
        document["extensions"]["VRMC_springBone"] = _springs(document, buffer, chains)
    return packed(document, buffer)


def _constrain(nodes: list[dict[str, Any]]) -> None:
    """Players turn each halfway bone by half of what its bone does."""
    for node, source in zip(HALFWAY_NODES, SOURCES, strict=True):
        turn = {"specVersion": "1.0", "constraint": {"rotation": {"source": source, "weight": 0.5}}}
        nodes[node]["extensions"] = {"VRMC_node_constraint": turn}


def _humanoid(character: Character, name: str, *, thumbnail: int) -> dict[str, Any]:
    eyes = character.positions[character.materials == [m.name for m in MATERIALS].index("eye")]
    middle = (eyes.min(0) + eyes.max(0)) / 2 - REST[HUMANOID.index("head")]
    across, upwards = ({"inputMaxValue": float(np.degrees(x)), "outputScale": 1.0} for x in (ACROSS, UPWARDS))
    return {
        "specVersion": "1.0",
        "meta": {"name": name.capitalize(), **META, "thumbnailImage": thumbnail},
        "humanoid": {"humanBones": {bone: {"node": joint} for joint, bone in enumerate(HUMANOID.names)}},
        "firstPerson": {
            "meshAnnotations": [{"node": BODY_NODE, "type": "auto"}, {"node": FACE_NODE, "type": "thirdPersonOnly"}]
        },
        "lookAt": {
            "offsetFromHeadBone": [round(float(x), 4) for x in middle],
            "type": "expression",
            "rangeMapHorizontalInner": across,
            "rangeMapHorizontalOuter": across,
            "rangeMapVerticalDown": upwards,
            "rangeMapVerticalUp": upwards,
        },
        "expressions": expressions(),
    }


def _portrait(character: Character, name: str, buffer: Buffer) -> dict[str, Any]:
    """The file's square thumbnail as an image of the document."""
    camera = Camera((0.12, 1.60, 1.25), (0.0, 1.55, 0.0), 0.34)
    picture = shot(character, Paint.of(character), camera, (512, 512), DOWN, {"mouthSmile": 0.3})
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=85)
    view = buffer.view(np.frombuffer(stream.getvalue(), np.uint8))
    return {"name": f"{name}_thumbnail", "mimeType": "image/jpeg", "bufferView": view}


def hair_chains(character: Character) -> list[Chain]:
    """Chains of bones in the hair around the head, each from the height of the ears to the ends."""
    hair = character.positions[_hair(character)].astype(float)
    head = REST[HUMANOID.index("head")].astype(float)
    turn, top = _around(hair, head), head[1] + SWING_FROM
    made = []
    for middle in np.linspace(FACE_HALF, 2 * np.pi - FACE_HALF, CHAINS):
        near = hair[(np.abs(turn - middle) < (np.pi - FACE_HALF) / CHAINS) & (hair[:, 1] < top + 0.02)]
        if len(near) < 20:
            continue
        heights = np.linspace(top, np.percentile(near[:, 1], 2), LINKS + 1)
        reach = np.hypot(near[:, 0] - head[0], near[:, 2] - head[2])
        nearest = np.abs(near[:, 1] - heights[:, None]) < 0.02
        far = np.array([reach[level].mean() if level.any() else reach.mean() for level in nearest])
        made.append(np.stack([head[0] + far * np.sin(middle), heights, head[2] + far * np.cos(middle)], 1))
    return made


def with_chains(character: Character, chains: list[Chain]) -> Character:
    """The character whose hair follows the chains: bone 56 + 3 c + k is link k of chain c."""
    if not chains:
        return character
    rows = np.flatnonzero(_hair(character))
    head = HUMANOID.index("head")
    middle = REST[head]
    points = character.positions[rows]
    turns = np.array([_around(chain[:1], middle)[0] for chain in chains])
    apart = np.abs(_around(points, middle)[:, None] - turns)
    near = np.argsort(apart, 1)[:, :2]
    weight = 1 / (np.take_along_axis(apart, near, 1) + 0.02) ** 2
    weight /= weight.sum(1, keepdims=True)
    joints, shares = np.zeros((len(rows), 4), np.uint8), np.zeros((len(rows), 4), np.float32)
    for i in range(2):
        heights = np.stack([chains[c][:, 1] for c in near[:, i]])
        step = (heights[:, 0] - heights[:, -1]) / LINKS
        depth = np.clip((heights[:, 0] - points[:, 1]) / step, 0, LINKS - 1e-4)
        link, within = np.floor(depth).astype(int), depth % 1
        within = np.where(link == 0, within, np.minimum(2 * within, 1))
        own = len(BONES) + near[:, i] * LINKS + link
        joints[:, 2 * i] = own
        joints[:, 2 * i + 1] = np.where(link == 0, head, own - 1)
        shares[:, 2 * i], shares[:, 2 * i + 1] = weight[:, i] * within, weight[:, i] * (1 - within)
    doubled = (joints[:, 1] == joints[:, 3]) & (joints[:, 1] == head)
    shares[doubled, 1] += shares[doubled, 3]  # a joint may be named once with a weight
    shares[doubled, 3] = 0
    shares = np.where(shares < LEAST_SHARE, 0, shares)
    shares /= shares.sum(1, keepdims=True)
    all_joints, all_weights = character.joints.copy(), character.weights.copy()
    all_joints[rows], all_weights[rows] = joints, shares
    return replace(character, joints=all_joints, weights=all_weights)


def _springs(document: dict[str, Any], buffer: Buffer, chains: list[Chain]) -> dict[str, Any]:
    """Adds the chains' nodes below the head and to the skin; returns the extension that swings them."""
    nodes, head = document["nodes"], HUMANOID.index("head")
    origin = REST
    binds, joints, springs = [-origin], [], []
    for number, places in enumerate(chains):
        parent, at, line = head, origin[head], []
        for link, place in enumerate(places):
            nodes.append({"name": f"hair{number}_{link}", "translation": [round(float(x), 6) for x in place - at]})
            nodes[parent].setdefault("children", []).append(len(nodes) - 1)
            parent, at = len(nodes) - 1, place
            line.append(parent)
        joints += line[:LINKS]
        binds.append(-places[:LINKS])
        feel = {"hitRadius": 0.008, "stiffness": 1.1, "gravityPower": 0.15, "gravityDir": [0, -1, 0], "dragForce": 0.45}
        springs.append(
            {
                "name": f"hair{number}",
                "joints": [{"node": node, **feel} for node in line],
                "colliderGroups": [0],
                "center": 0,
            }
        )
    skin = document["skins"][0]
    skin["joints"] = [*skin["joints"], *joints]
    matrices = np.tile(np.eye(4, dtype=np.float32), (len(skin["joints"]), 1, 1))
    matrices[:, 3, :3] = np.concatenate(binds)
    skin["inverseBindMatrices"] = buffer.add(matrices)
    chest, neck = HUMANOID.index("upperChest"), HUMANOID.index("neck")
    shoulder = origin[HUMANOID.index("leftUpperArm")] - origin[chest]
    left, right = ([round(float(x), 4) for x in shoulder * [side, 1, 1]] for side in (0.8, -0.8))
    colliders = [
        {"node": head, "shape": {"sphere": {"offset": [0, 0.07, 0.01], "radius": 0.078}}},
        {"node": neck, "shape": {"capsule": {"offset": [0, -0.02, 0], "tail": [0, 0.08, 0.01], "radius": 0.05}}},
        {"node": chest, "shape": {"capsule": {"offset": left, "tail": right, "radius": 0.05}}},
    ]
    return {
        "specVersion": "1.0",
        "colliders": colliders,
        "colliderGroups": [{"name": "body", "colliders": list(range(len(colliders)))}],
        "springs": springs,
    }


def _hair(character: Character) -> Float[np.ndarray, " v"]:
    return np.asarray(character.materials == [material.name for material in MATERIALS].index("hair"))


def _around(points: Float[np.ndarray, "n 3"], middle: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " n"]:
    """The angle around the head from the front, 0 to 2 pi."""
    return np.asarray(np.arctan2(points[:, 0] - middle[0], points[:, 2] - middle[2]) % (2 * np.pi))


def main() -> None:
    """Write the named people, or all, as VRM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(CHARACTERS), help=f"of {', '.join(CHARACTERS)}")
    parser.add_argument("--out", type=Path, default=Path("build/vrm"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.names:
        path = args.out / f"{name}.vrm"
        path.write_bytes(pack_vrm(simplified(load_character(name), 0), name, hangs=PEOPLE[name].hair_style in HANGING))
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    print(f"check them: node {Path(__file__).parents[2] / 'vrm.mjs'} {args.out}/*.vrm")


if __name__ == "__main__":
    main()
