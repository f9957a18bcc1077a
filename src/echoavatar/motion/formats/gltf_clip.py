"""Read an animation of a character in a GLB, VRM or VRMA file as motion.

Keys are sampled at the rate at which they lie closest, or at 30 frames per second where they are sparse. A bone's
rotation is that of its node against the rest pose of the rig (`gltf_rig`), so animated nodes above the hips count, and
so do scales.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import ROTATIONS
from echoavatar.timing import FRAME_RATE_HZ

from ..kinematics import Motion
from ..kinematics.motion import usual_rate
from ..kinematics.rigs import JointMap
from ..kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp
from ..kinematics.skeleton import numbered
from ..kinematics.upright import placed
from .gltf_data import refusing_damage
from .gltf_nodes import Array, above, node_matrix, rotation_of, scale_of, unscaled
from .gltf_rig import GltfRig, read_gltf_rig
from .reading import reading

_RATES = (10.0, 240.0)  # keys per second that count as a frame rate; an animator or a reducer leaves fewer
_SMALL = 0.05  # share of the steps between keys that may be smaller than a frame
_EVEN = 0.1  # of a step: 32-bit times of a long clip are uneven
_PATHS = {"translation": 3, "rotation": 4, "scale": 3}
_APART_S = 0.9  # the times of keys that are farther apart may be frame numbers
_MS, _MANY = 8.0, 8  # keys farther apart, and more in each track, have their times in milliseconds
_STILL = 1e-5  # keys that differ by less do not move
_Track = tuple[Float[Array, " k"], Float[Array, "k n c"], str]
_Targets = dict[tuple[int, str], int]  # the sampler of each node and property


def read_gltf_clip(path: Path, animation: str | None = None, given: JointMap | None = None) -> Motion:
    """The animation of this name, or the first in which a bone moves; `given` is the user's map of the bones.

    Some programs write an animation for each node. Without `animation`, these are read as one.

    Raises:
        MotionError: the file is missing or damaged, its bones are not known, or it has no such animation.
        DependencyError: the file is compressed, and the package that unpacks it is missing.
    """
    rig = read_gltf_rig(path, given)
    # `Motion` refuses values that are not finite
    with reading(path) as notes, refusing_damage(path), np.errstate(invalid="ignore", over="ignore"):
        entries = rig.document.get("animations", [])
        known = numbered(str(entry.get("name", k)) for k, entry in enumerate(entries))
        if not known:
            raise MotionError("it has no animation; choose another file")
        if animation is not None and animation not in known:
            raise MotionError(f"it has no animation named {animation!r}; it has {', '.join(known)}")
        needed = {*rig.order, *above(rig.parents, rig.order[0])}
        targets = [_targets(entry, needed) for entry in entries]
        chosen = [known.index(animation)] if animation is not None else _chosen(rig, entries, targets)
        if animation is None and len(known) > 1:
            read = f"{known[chosen[0]]!r} is read" if len(chosen) == 1 else f"{len(chosen)} are read as one"
            notes.append(f"it has {len(known)} animations ({', '.join(known)}); {read}")
        tracks = {
            target: _keys(rig, entries[k]["samplers"][sampler], _PATHS[target[1]])
            for k in chosen
            for target, sampler in targets[k].items()
        }
        vrma = rig.document.get("extensions", {}).get("VRMC_vrm_animation", {})
        if "expressions" in vrma or any(
            at["target"]["path"] == "weights" for k in chosen for at in entries[k]["channels"]
        ):
            notes.append("its body is read, and its face is left out; a recording (.npz) keeps both")
        if not tracks:
            raise MotionError(f"its animation {known[chosen[0]]!r} moves no bone; choose another")
        return _sampled(rig, tracks, needed, notes)


def _chosen(rig: GltfRig, entries: list[dict[str, Any]], targets: list[_Targets]) -> list[int]:
    """The first animation in which a bone moves; or all, if no two share a node and all but one have a single node."""

    def moves(k: int) -> bool:
        samplers = [entries[k]["samplers"][number] for number in targets[k].values()]
        keys = [
            rig.accessor(one["output"])[slice(1, None, 3) if one.get("interpolation") == "CUBICSPLINE" else slice(None)]
            for one in samplers
        ]
        return any(len(values) and np.ptp(values, axis=0).max() > _STILL for values in keys)

    touching = [k for k, some in enumerate(targets) if some] or [0]
    nodes = [{node for node, _ in targets[k]} for k in touching]
    if sum(map(len, nodes)) == len(set().union(*nodes)) and sum(len(some) > 1 for some in nodes) < 2:
        return touching
    return [next(filter(moves, touching), touching[0])]


def _targets(entry: dict[str, Any], nodes: set[int]) -> _Targets:
    """The sampler of each of these nodes, and of each of its properties, that an animation moves."""
    channels = [(channel["target"], channel["sampler"]) for channel in entry["channels"]]
    return {(at["node"], at["path"]): k for at, k in channels if at.get("node") in nodes and at["path"] in _PATHS}


def _sampled(rig: GltfRig, tracks: dict[tuple[int, str], _Track], needed: set[int], notes: list[str]) -> Motion:
    """The motion of all frames, in our axes; `notes` receives what was assumed."""
    first, last = (pick([pick(keys) for keys, _, _ in tracks.values()]) for pick in (np.min, np.max))
    steps = np.concatenate([np.diff(keys) for keys, _, _ in tracks.values()])
    steps = steps[steps > 0]  # two keys at one time are a jump
    small = float(np.quantile(steps, _SMALL, method="lower")) if steps.size else 0.0
    steps = steps[np.abs(steps - small) < _EVEN * small]
    step = float(steps.mean()) if steps.size else 1 / FRAME_RATE_HZ
    is_ms = step > _MS and steps.size > _MANY * len(tracks)
    per_second = 1000.0 if is_ms else 1.0
    if is_ms:
        notes.append("the times of its keys are taken for milliseconds")
    elif step > _APART_S:
        notes.append(f"its keys are {step:.3g} s apart; if their times are frames or milliseconds, write seconds")
    fps = usual_rate(per_second / step)
    fps = fps if _RATES[0] <= fps <= _RATES[1] else float(FRAME_RATE_HZ)
    frames = int((last - first) * fps / per_second + 1e-3) + 1
    if frames * len(needed) > ROTATIONS:
        raise MotionError(f"{frames:,} frames of {len(needed)} bones are more than is read; cut it")
    times = first + np.arange(frames) * per_second / fps
    nodes = rig.document["nodes"]
    root = next(node for node, parent in rig.parents.items() if parent < 0)
    outside = rig.matrices[root] @ np.linalg.inv(node_matrix(nodes[root]))  # from the world to the hips' space
    worlds = {-1: outside}
    for node, parent in rig.parents.items():  # parents first
        if node in needed:
            own = {path: _at(tracks[node, path], times) for path in _PATHS if (node, path) in tracks}
            worlds[node] = worlds[parent] @ (_matrices(nodes[node], own) if own else node_matrix(nodes[node]))
    full = np.stack([np.broadcast_to(worlds[node], (frames, 4, 4)) for node in rig.order], 1)
    turned = rig.turn @ unscaled(full) @ rig.frames.swapaxes(-1, -2)
    local = turned.copy()
    local[:, 1:] = turned[:, list(rig.skeleton.parents[1:])].swapaxes(-1, -2) @ turned[:, 1:]
    places = rig.unit * full[:, 0, :3, 3] @ rig.turn.T
    rotations = quaternion_from_matrix(local).astype(np.float32)
    motion = Motion(rig.skeleton, rotations, places.astype(np.float32), fps)
    motion = placed(motion, rig.skeleton.config.vrm, notes)
    return replace(motion, root=(motion.root - rig.place(rig.order[0]) * [1, 0, 1]).astype(np.float32))


def _keys(rig: GltfRig, sampler: dict[str, Any], width: int) -> _Track:
    """Times, values (with tangents before and after for a cubic spline) and kind of interpolation."""
    times, values = (rig.accessor(sampler[key]) for key in ("input", "output"))
    kind = sampler.get("interpolation", "LINEAR")
    values = values.reshape(len(times), 3 if kind == "CUBICSPLINE" else 1, width)
    if not len(times) or not (
        np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times[:, 0]) >= 0).all()
    ):
        raise ValueError("keys that go back in time, or are not finite")
    return times[:, 0], values, kind


def _at(track: _Track, times: Float[Array, " t"]) -> Float[Array, "t c"]:
    """The values at these times."""
    keys, values, kind = track
    last, rounded = len(keys) - 1, 2 * np.spacing(np.float32(np.abs(keys).max()))
    before = np.clip(np.searchsorted(keys, times + 1e-6 + rounded, "right") - 1, 0, last)
    after = np.minimum(before + 1, last)
    span = keys[after] - keys[before]
    share = np.clip((times - keys[before]) / np.where(span > 0, span, 1), 0, 1)[:, None]
    share = np.zeros_like(share) if kind == "STEP" else share
    if kind == "CUBICSPLINE":
        (_, start, leaving), (arriving, end, _) = values[before].swapaxes(0, 1), values[after].swapaxes(0, 1)
        slopes = span[:, None] * (leaving * share * (1 - share) ** 2 - arriving * share**2 * (1 - share))
        between: Array = start + (end - start) * share**2 * (3 - 2 * share) + slopes
        return between
    start, end = values[before, 0], values[after, 0]
    if values.shape[-1] == 4:
        return slerp(start[:, [3, 0, 1, 2]], end[:, [3, 0, 1, 2]], share[:, 0])[:, [1, 2, 3, 0]]
    between = start + share * (end - start)
    return between


def _matrices(node: dict[str, Any], own: dict[str, Float[Array, "t c"]]) -> Float[Array, "t 4 4"]:
    """A node's matrix at each time; what is not animated is as the node has it."""
    frames = len(next(iter(own.values())))
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    turns = own["rotation"] if "rotation" in own else rotation_of(node)[None]
    matrices[:, :3, :3] = matrix_from_quaternion(turns[:, [3, 0, 1, 2]])
    matrices[:, :3, :3] *= (own["scale"] if "scale" in own else scale_of(node)[None])[:, None]
    matrices[:, :3, 3] = own["translation"] if "translation" in own else node_matrix(node)[:3, 3]
    return matrices
