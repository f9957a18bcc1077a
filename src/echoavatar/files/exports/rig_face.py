"""The face on the user's own character: the morph targets that our curves move.

They are found by their names, or through the expressions of a VRM, whichever shows more of the face.
"""

import logging
from collections import defaultdict
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.limits import BINDS, MORPHS, ROTATIONS
from echoavatar.motion.arkit import APPLE_NAMES
from echoavatar.motion.face_names import VRM0, driven, face_weights, silent_curves

Array = np.ndarray
_Bind = tuple[str, int, int, float]  # expression, node, morph target, weight
_LOG = logging.getLogger(__name__)
_TOLD = 6  # curves that a warning names
_JAW = APPLE_NAMES.index("jawOpen"), sorted(APPLE_NAMES).index("jawOpen")


def face_on(path: Path, document: dict[str, Any], curves: Float[Array, "t 52"]) -> dict[int, Float[Array, "t n"]]:
    """Weights of the morph targets of each node with a face; a warning names the curves that move nothing."""
    named, (expressed, binds) = _named(document, len(curves)), _expressed(document)
    silent = silent_curves(np.concatenate([expressed[:, :0], *named.values()], 1))
    if len(still := silent_curves(expressed)) <= len(silent) and binds:
        weights, silent = face_weights(expressed, curves), still
        found = {node: np.clip(weights @ table, 0, 1) for node, table in binds.items()}
    else:
        found = {node: face_weights(shares, curves) for node, shares in named.items() if shares.any()}
    if not found:
        _LOG.warning("%s: its face stays still: it has no morph targets with names of a face", path)
    elif silent:
        told, more = ", ".join(silent[:_TOLD]), len(silent) - _TOLD
        _LOG.warning("%s: nothing on its face shows %s%s", path, told, f" and {more} more" if more > 0 else "")
    return found


def expression_weights(document: dict[str, Any], curves: Float[Array, "t 52"]) -> dict[str, Float[Array, " t"]]:
    """Weights of those expressions of a VRM that our curves move, by their names in VRM 1.0."""
    names = list(dict.fromkeys(name for name, *_ in _binds(document)))
    shares = driven(names)
    weights = face_weights(shares, curves)
    return {name: weights[:, k] for k, name in enumerate(names) if shares[:, k].any()}


def _named(document: dict[str, Any], frames: int) -> dict[int, Float[Array, "k n"]]:
    """For each node, how the curves drive its morph targets by their names (see `driven`)."""
    meshes: dict[int, Array] = {}
    found: dict[int, Array] = {}
    total = 0
    for node, entry in enumerate(document["nodes"]):
        if "mesh" not in entry:
            continue
        total += len(document["meshes"][entry["mesh"]]["primitives"][0].get("targets", []))
        if total > MORPHS:
            raise ValueError(f"{total:,} morph targets, more than {MORPHS:,}")
        if total * frames > ROTATIONS:
            raise ValueError(f"{total:,} morph targets in {frames:,} frames, more than is written; cut the take")
        if entry["mesh"] not in meshes:
            meshes[entry["mesh"]] = driven(target_names(document, document["meshes"][entry["mesh"]]))
        found[node] = meshes[entry["mesh"]]
    return found


def _expressed(document: dict[str, Any]) -> tuple[Float[Array, "k e"], dict[int, Float[Array, "e n"]]]:
    """How the curves drive a VRM's expressions by name, and how far these move the morph targets of each node."""
    binds = _binds(document)
    names = list(dict.fromkeys(name for name, *_ in binds))
    tables: dict[int, Array] = {}
    for name, node, index, share in binds:
        mesh = document["meshes"][document["nodes"][node]["mesh"]]
        count = len(mesh["primitives"][0].get("targets", []))
        if 0 <= index < count:
            table = tables.setdefault(node, np.zeros((len(names), count), np.float32))
            table[names.index(name), index] += share
    return driven(names), tables


def _binds(document: dict[str, Any]) -> list[_Bind]:
    """The binds of a VRM's expressions. A bind of VRM 0.x counts for each node of its mesh."""
    made = list(islice(_each_bind(document), BINDS + 1))
    if len(made) > BINDS:
        raise ValueError(f"expressions that name more than {BINDS:,} morph targets")
    return made


def _each_bind(document: dict[str, Any]) -> Iterator[_Bind]:
    extensions = document.get("extensions", {})
    expressions = extensions.get("VRMC_vrm", {}).get("expressions", {})
    for name, entry in [item for kind in ("preset", "custom") for item in expressions.get(kind, {}).items()]:
        for bind in entry.get("morphTargetBinds", []):
            yield name, bind["node"], bind["index"], bind.get("weight", 1.0)
    users: defaultdict[int, list[int]] = defaultdict(list)  # the nodes of each mesh
    for node, entry in enumerate(document["nodes"]):
        if "mesh" in entry:
            users[entry["mesh"]].append(node)
    for group in extensions.get("VRM", {}).get("blendShapeMaster", {}).get("blendShapeGroups", []):
        preset = str(group.get("presetName") or "unknown").lower()
        name = str(group.get("name", "")) if preset == "unknown" else VRM0.get(preset, preset)
        for bind in group.get("binds", []):
            for node in users[bind["mesh"]]:
                yield name, node, bind["index"], bind["weight"] / 100


def target_names(document: dict[str, Any], mesh: dict[str, Any]) -> list[str]:
    """The name of each morph target, from wherever exporters write it; "" where there is none.

    52 targets without names (51: no tongue) are ARKit's, in Apple's order, or alphabetical if its jaw moves more.
    """
    part = mesh["primitives"][0]
    targets, accessors = part.get("targets", []), document.get("accessors", [])
    for named in (mesh, part):
        if len(names := named.get("extras", {}).get("targetNames", [])) == len(targets) > 0:
            return [str(name) for name in names]
    places = [
        accessors[target["POSITION"]] if target.get("POSITION", -1) in range(len(accessors)) else {}
        for target in targets
    ]
    extras = [
        target.get("extra") or target.get("extras") or place for target, place in zip(targets, places, strict=True)
    ]
    names = [str(extra.get("name") or "") for extra in extras]
    if any(names) or len(targets) not in (len(APPLE_NAMES), len(APPLE_NAMES) - 1):
        return names
    apple, alphabet = (max(map(abs, [*places[jaw].get("min", [0]), *places[jaw].get("max", [0])])) for jaw in _JAW)
    order = sorted(APPLE_NAMES) if alphabet > apple else APPLE_NAMES
    return [name for name in order if len(targets) == len(order) or name != "tongueOut"]
