"""Rigs as programs write them, drawn by a seed: each holds the pose that the plain one of its kind holds.

Two rigs have the same body. One is plain: T-pose, at the origin, metres, Y up, facing +Z, joints without rotations. The
other is moved, turned, scaled or mirrored above its hips, stands in another rest pose, has joints of any axes and
scales, another unit, other bones in between, a bind pose of its own. The same take is written into both files. Read
without our reader, every bone of the odd one must be where that of the plain one is, in the frame of the body, to 1 mm
on a body of our size.

    python -m tests.files.exports.odd_rigs 500          GLB and BVH rigs with the seeds 0 to 499, and a summary
    python -m tests.files.exports.odd_rigs 1 --from 37 --keep out/    one of them, and its files
"""

import argparse
import json
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tests.files.exports.bodies import NAMES
from tests.files.exports.moving import clapping
from tests.files.exports.odd import Odd, bvh, drawn, glb

from echoavatar.errors import MotionError
from echoavatar.files.exports import Take, read_rig, read_take, write_take
from echoavatar.motion.kinematics import Motion

Array = np.ndarray
TOLERANCE = 1e-3  # of a body 1.7 m tall, metres


def places_in(path: Path) -> tuple[list[str], Array]:
    """Names of a GLB's nodes and their world matrices (t, n, 4, 4), read without any reader of ours."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    nodes = document["nodes"]

    def values(index: int) -> Array:
        accessor = document["accessors"][index]
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        flat = np.frombuffer(binary, "<f4", accessor["count"] * width, start).astype(np.float64)
        return flat.reshape(-1, width)

    (animation,) = document["animations"]
    frames = document["accessors"][animation["samplers"][0]["input"]]["count"]
    moved: dict[int, dict[str, Array]] = {}
    for channel in animation["channels"]:
        target = channel["target"]
        moved.setdefault(target["node"], {})[target["path"]] = values(
            animation["samplers"][channel["sampler"]]["output"]
        )
    worlds = np.tile(np.eye(4), (frames, len(nodes), 1, 1))

    def place(node: int, over: Array) -> None:
        entry, own = nodes[node], np.tile(np.eye(4), (frames, 1, 1))
        if "matrix" in entry:
            own[:] = np.array(entry["matrix"]).reshape(4, 4).T
        else:
            track = moved.get(node, {})
            x, y, z, w = np.broadcast_to(track.get("rotation", entry.get("rotation", [0, 0, 0, 1])), (frames, 4)).T
            own[:, 0, 0], own[:, 1, 1], own[:, 2, 2] = (1 - 2 * (b * b + c * c) for b, c in ((y, z), (x, z), (x, y)))
            own[:, 0, 1], own[:, 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
            own[:, 0, 2], own[:, 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
            own[:, 1, 2], own[:, 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
            own[:, :3, :3] *= np.broadcast_to(entry.get("scale", [1, 1, 1]), (frames, 1, 3))
            own[:, :3, 3] = track.get("translation", entry.get("translation", [0, 0, 0]))
        worlds[:, node] = over @ own
        for child in entry.get("children", []):
            place(child, worlds[:, node])

    children = {child for entry in nodes for child in entry.get("children", [])}
    for node in range(len(nodes)):
        if node not in children:
            place(node, np.tile(np.eye(4), (frames, 1, 1)))
    return [entry.get("name", "") for entry in nodes], worlds


def places_in_bvh(path: Path) -> tuple[list[str], Array]:
    """The same of a BVH, without scales."""
    from echoavatar.motion.formats import read_bvh

    motion = read_bvh(path, metres_per_unit=1.0)
    places = motion.pose(np.float64).positions
    worlds = np.tile(np.eye(4), (*places.shape[:2], 1, 1))
    worlds[..., :3, 3] = places
    return list(motion.skeleton.names), worlds


def pose_in(path: Path, odd: Odd) -> Array:
    """Where the bones are from the hips, in the body's axes and metres (t, j, 3)."""
    names, worlds = places_in(path) if path.suffix != ".bvh" else places_in_bvh(path)
    own = [odd.names[name] for name in NAMES]
    at = [names.index("_".join(name.split()) if path.suffix == ".bvh" else name) for name in own]
    over = np.eye(4) if path.suffix == ".bvh" else odd.over
    inner = (np.linalg.inv(over) @ worlds[:, at])[..., :3, 3]
    from_hips: Array = (inner - inner[:, :1]) @ np.linalg.inv(odd.baked).T
    return from_hips / (np.linalg.norm(odd.body[NAMES.index("leftLowerLeg")]) / 0.41)


@dataclass
class Outcome:
    """What became of a rig."""

    seed: int
    error: float = 0.0  # metres on a body of our size, as a rig
    as_source: float = 0.0  # the same of the written file as a source of motion
    refusal: str = ""


def tried(odd: Odd, take: Take, folder: Path, suffix: str) -> Outcome:
    """Write a take into an odd rig and its plain one, and compare."""
    key = odd.body.tobytes(), take.motion.frames, suffix
    if key not in _PLAIN:
        _PLAIN[key] = written(odd.plain, take, folder, suffix)
    try:
        pose, source = written(odd, take, folder, suffix)
    except MotionError as error:
        return Outcome(odd.seed, refusal=str(error).replace(str(folder), ""))
    plain, plain_source = _PLAIN[key]
    return Outcome(odd.seed, float(np.abs(pose - plain).max()), _apart(source, plain_source))


_PLAIN: dict[tuple[bytes, int, str], tuple[Array, Motion]] = {}


def written(odd: Odd, take: Take, folder: Path, suffix: str) -> tuple[Array, Motion]:
    """The pose in a rig's file with a take in it, and the motion that the file gives our rig as a source."""
    path, out = folder / f"rig{suffix}", folder / f"out{suffix}"
    if suffix == ".bvh":
        bvh(odd, path)
    else:
        path.write_bytes(glb(odd))
    write_take(out, take, rig=read_rig(path))
    return pose_in(out, odd), read_take(out).on_humanoid().motion


def _apart(one: Motion, other: Motion) -> float:
    a, b = (motion.pose(np.float64).positions for motion in (one, other))
    return float(np.abs((a - a[:, :1]) - (b - b[:, :1])).max())


def outcomes(seeds: range, folder: Path) -> Iterator[tuple[Odd, str, Outcome]]:
    """Each seed as a GLB; one in four as a BVH too."""
    take = Take(clapping(1.2), None, None)
    for seed in seeds:
        odd = drawn(seed)
        for suffix in (".glb", ".bvh") if seed % 4 == 0 and not odd.is_vrm else (".glb",):
            yield odd, suffix, tried(odd, take, folder, suffix)


def main() -> None:
    """Try them, and print how many held."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--from", type=int, default=0, dest="start")
    parser.add_argument("--keep", type=Path, help="folder for the files of the last one")
    args = parser.parse_args()
    folder = args.keep or Path(tempfile.mkdtemp())
    folder.mkdir(exist_ok=True)
    held, refused, worst, far = 0, Counter[str](), [0.0, 0.0], []
    for odd, suffix, outcome in outcomes(range(args.start, args.start + args.count), folder):
        if outcome.refusal:
            refused[outcome.refusal[:160]] += 1
            continue
        errors = outcome.error, outcome.as_source
        worst = [max(a, b) for a, b in zip(worst, errors, strict=True)]
        held += max(errors) < TOLERANCE
        if max(errors) >= TOLERANCE:
            how = f"{odd.pose} {odd.bind} {odd.names['hips']}, {len(odd.above)} nodes above"
            far.append(f"{odd.seed}{suffix} ({how}): {1e3 * errors[0]:.2f} and {1e3 * errors[1]:.2f} mm\n")
    lines = [
        f"{held} held the pose: {1e3 * worst[0]:.4f} mm off at most, and {1e3 * worst[1]:.4f} mm as a source\n",
        f"{len(far)} did not\n",
        *far,
        f"{sum(refused.values())} were refused\n",
        *(f"{count}: {why}\n" for why, count in refused.most_common()),
    ]
    sys.stdout.writelines(lines)


if __name__ == "__main__":
    main()
