"""Rigs as programs write them, drawn by a seed, as GLB and BVH files; `odd_rigs` tries them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from operator import methodcaller
from pathlib import Path
from typing import Any

import numpy as np
from tests.files.exports.bodies import CORNERS, HUMANOID, MIXAMO, NAMES, ROUND, TRIANGLES, offsets_of
from tests.motion.kinematics.naming import body as named_body
from tests.motion.kinematics.naming import every_body

from echoavatar.files.avatar.gltf import Buffer, container
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import Skeleton, SkeletonConfig, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix
from echoavatar.motion.kinematics.upright import Stand

Array = np.ndarray
BODIES = 12  # how many there are
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
CONVENTIONS = {name: named_body(*entry).bones for name, entry in every_body().items()}
CONVENTIONS = {name: bones for name, bones in CONVENTIONS.items() if set(NAMES) <= bones.keys()}
AROUND = ("{}", "{}", "hero_{}", "rig:{}", "Armature|{}", "{}.001", "{}_jnt", "upper", "lower")
POSES = ("T", "A", "N", "hands", "knees", "one up", "ahead", "sitting", "any")


@dataclass(frozen=True)
class Odd:
    """How a rig differs from the plain one of its body."""

    body: Array  # rest offsets in T-pose (j, 3)
    names: Mapping[str, str] = field(default_factory=lambda: MIXAMO)  # of bones to those of joints
    is_vrm: bool = False  # whether the map of a VRM says which joint is which
    pose: str = "T"
    bind: str = ""  # the pose in which the mesh was bound, "" for the nodes' own
    axes: Array | None = None  # (j, 3) rotation of each joint's axes
    scales: Array = field(default_factory=lambda: np.ones(len(NAMES)))  # of each joint
    above: tuple[Array, ...] = ()  # matrices of nodes above the hips, the topmost first
    baked: Array = field(default_factory=lambda: np.eye(3))  # turn and unit of the joints themselves
    twists: bool = False  # a joint in the middle of each limb
    hair: int = 0  # joints on the head
    second: bool = False  # another character in the scene
    skins: int = 1
    animated: bool = False
    mirrored_arm: bool = False  # the axes of the right arm's joints, as some programs mirror bones
    root_joint: bool = False  # the skin lists the node above the hips too
    in_world: bool = False  # whether the mesh is in the world's space, not in that of the hips
    seed: int = 0

    @property
    def over(self) -> Array:
        """From the hips' space to the world."""
        over = np.eye(4)
        for matrix in self.above:
            over = over @ matrix
        return over

    @property
    def plain(self) -> "Odd":
        """The same body without any of it."""
        return Odd(self.body, {name: name for name in NAMES})


@cache
def body_of(number: int) -> Array:
    """Rest offsets of a body: other proportions, and hardly symmetric."""
    draw = np.random.default_rng(10_000 + number)
    body = offsets_of(**{part: draw.uniform(0.75, 1.25) for part in ("body", "legs", "arms", "hands")})
    uneven = 0.004 * np.linalg.norm(body, axis=1, keepdims=True)
    uneven[[0, NAMES.index("leftUpperLeg"), NAMES.index("rightUpperLeg")]] = 0  # they tell where a body faces
    offsets: Array = body + draw.normal(0, 1, body.shape) * uneven
    return offsets


def drawn(seed: int) -> Odd:
    """A rig by its seed."""
    draw = np.random.default_rng(seed)
    body = body_of(seed % BODIES)

    def some(share: float) -> bool:
        return bool(draw.random() < share)

    odd = Odd(body, *_named(draw, some), str(draw.choice(POSES)), seed=seed)
    if some(0.3):
        odd = replace(odd, bind=str(draw.choice(POSES[:4])))
    if some(0.7):
        odd = replace(odd, axes=draw.normal(0, 1.2, (len(NAMES), 3)))
    if some(0.25):
        odd = replace(odd, scales=np.exp(draw.normal(0, 0.3, len(NAMES))))
    above = [_node(draw, some) for _ in range(draw.integers(0, 4))]
    if some(0.3):  # as Blender and FBX2glTF write
        above.insert(0, _matrix(np.array([-np.pi / 2, 0, 0]), 0.01))
        odd = replace(odd, baked=_turn([np.pi / 2, 0, 0]) * 100)
    elif some(0.4):
        angle = draw.choice([np.pi, np.pi / 2, -np.pi / 2, draw.uniform(-3, 3)])
        unit = draw.choice([1.0, 100.0, 1000.0, 1 / 0.0254])
        up = _turn(np.pi / 2 * draw.choice([(0, 0, 0), (0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)]))
        odd = replace(odd, baked=up @ _turn([0, angle, 0]) * unit)
    odd = replace(odd, above=tuple(above))
    metre = np.cbrt(abs(np.linalg.det(odd.over[:3, :3] @ odd.baked)))
    is_precise = bool(np.linalg.norm(odd.over[:3, 3]) < 3 * metre)  # as 32-bit numbers of a mesh in the world are
    return replace(
        odd,
        twists=some(0.4),
        hair=int(draw.integers(0, 4)) if some(0.5) else 0,
        second=some(0.15),
        skins=2 if some(0.2) else 1,
        animated=some(0.2),
        in_world=some(0.5) and is_precise,
        mirrored_arm=some(0.15),
        root_joint=bool(above) and some(0.4),
    )


def _named(draw: np.random.Generator, some: Any) -> tuple[dict[str, str], bool]:
    """Names by a convention, with something around them; one rig in six is a VRM whose names say nothing."""
    if some(1 / 6):
        return {name: f"joint {k}" for k, name in enumerate(NAMES)}, True
    bones, around = CONVENTIONS[str(draw.choice(list(CONVENTIONS)))], str(draw.choice(AROUND))
    put = around.format if "{" in around else methodcaller(around)
    return {name: put(bones[name]) for name in NAMES}, False


def _node(draw: np.random.Generator, some: Any) -> Array:
    """A node above the hips: moved, turned, scaled; one in eight is mirrored, one in ten stretched."""
    node = _matrix(draw.normal(0, 1, 3) * draw.choice([0, 0.1, 2.0]), float(draw.choice([1.0, 0.01, 2.5, 0.4])))
    node[:3, 3] = draw.normal(0, 2, 3)
    if some(0.12):
        node[:3, :3] = node[:3, :3] @ np.diag([-1.0, 1.0, 1.0])
    if some(0.1):
        node[:3, :3] = node[:3, :3] @ np.diag(draw.uniform(0.8, 1.25, 3))
    return node


def _turn(axis_angle: Any) -> Array:
    turned: Array = matrix_from_axis_angle(np.asarray(axis_angle, np.float64))
    return turned


def _matrix(axis_angle: Array, scale: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * _turn(axis_angle)
    return matrix


def turns_of(pose: str, seed: int) -> Array:
    """Parent-relative turns (j, 3, 3) that bring the T-pose into a rest pose."""
    turns = np.tile(np.eye(3), (len(NAMES), 1, 1))

    def put(name: str, *axis_angle: float) -> None:
        turns[NAMES.index(name)] = _turn(axis_angle) @ turns[NAMES.index(name)]

    for side, sign in (("left", 1.0), ("right", -1.0)):
        if pose in ("A", "N"):
            put(f"{side}UpperArm", 0, 0, -sign * (0.8 if pose == "A" else 1.45))
        if pose == "hands":
            put(f"{side}Hand", sign * 1.4, 0, 0)
        if pose in ("knees", "sitting"):
            bent = 0.5 if pose == "knees" else 1.5
            put(f"{side}UpperLeg", -bent, 0, 0)
            put(f"{side}LowerLeg", 2 * bent if pose == "knees" else bent, 0, 0)
            put(f"{side}Foot", -bent if pose == "knees" else 0, 0, 0)
        if pose == "ahead":
            put(f"{side}UpperArm", 0.3, -sign * 1.5, 0)
            put(f"{side}LowerArm", sign * 0.6, -sign * 0.7, 0)
    if pose == "one up":
        put("rightUpperArm", 0.4, 0, -1.4)
        put("leftUpperArm", 0, 0, -1.2)
    if pose == "any":
        draw = np.random.default_rng(seed)
        for joint, name in enumerate(NAMES):
            if any(part in name for part in ("Arm", "Hand", *FINGERS)):
                turns[joint] = _turn(draw.normal(0, 0.4, 3))
    return turns


@dataclass
class Built:
    """A rig's joints, parents first: names, parents, matrices at rest and when bound, in the hips' space."""

    names: list[str]
    parents: list[int]
    rest: Array
    bind: Array
    stretched: Array  # of the bones, in T-pose
    bones: dict[str, int]


def built(odd: Odd) -> Built:
    """The joints of a rig in the space in which its hips move."""
    skeleton = Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, odd.body.tolist()))}))
    worlds = []
    for pose in (odd.pose, odd.bind or odd.pose, "T"):
        turns = turns_of(pose, odd.seed)[None]
        stands = forward_kinematics(skeleton, turns, odd.body[:1])
        matrix = np.tile(np.eye(4), (len(NAMES), 1, 1))
        axes = np.eye(3) if odd.axes is None else matrix_from_axis_angle(odd.axes)
        matrix[:, :3, :3] = stands.rotations[0] @ axes * odd.scales[:, None, None]
        if odd.mirrored_arm:
            arm = [
                k
                for k, n in enumerate(NAMES)
                if n.startswith("right") and any(p in n for p in ("Arm", "Hand", *FINGERS))
            ]
            matrix[arm, :3, :3] = matrix[arm, :3, :3] @ np.diag([-1.0, 1.0, 1.0])
        matrix[:, :3, 3] = stands.positions[0] @ odd.baked.T
        unit = np.cbrt(np.linalg.det(odd.baked))
        matrix[:, :3, :3] = odd.baked / unit @ matrix[:, :3, :3]
        worlds.append(matrix)
    names, parents = [odd.names[name] for name in NAMES], list(HUMANOID.parents)
    bones = {name: joint for joint, name in enumerate(NAMES)}
    rest, bind, stretched = worlds
    if odd.twists:
        for side in ("left", "right"):
            for upper, lower in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg")):
                joint, child = bones[side + upper], bones[side + lower]
                at = len(names)
                names.append(f"twist {side} {upper}")
                parents.append(joint)
                parents[child] = at
                middles = []
                for world in (rest, bind):
                    middle = world[joint].copy()
                    middle[:3, 3] = (world[joint][:3, 3] + world[child][:3, 3]) / 2
                    middles.append(middle)
                rest, bind = (np.concatenate([w, m[None]]) for w, m in zip((rest, bind), middles, strict=True))
    for strand in range(odd.hair):
        names.append(f"hair {strand}")
        parents.append(bones["head"])
        strands = []
        for world in (rest, bind):
            matrix = world[bones["head"]].copy()
            matrix[:3, 3] += odd.baked @ np.array([0.03 * strand, 0.2, -0.05])
            strands.append(matrix)
        rest, bind = (np.concatenate([w, m[None]]) for w, m in zip((rest, bind), strands, strict=True))
    return Built(names, parents, rest, bind, stretched, bones)


def glb(odd: Odd) -> bytes:
    """The rig as a GLB, or as a VRM where no name says which bone is which."""
    made, buffer = built(odd), Buffer()
    joints = len(made.names)
    nodes: list[dict[str, Any]] = [{"name": name} for name in made.names]
    for joint, parent in enumerate(made.parents):
        local = made.rest[joint] if parent < 0 else np.linalg.inv(made.rest[parent]) @ made.rest[joint]
        nodes[joint] |= _parts(local)
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
    top = 0
    for number, matrix in reversed(list(enumerate(odd.above))):
        nodes.append({"name": f"above {number}", "children": [top], "matrix": matrix.T.reshape(-1).tolist()})
        top = len(nodes) - 1
    over = odd.over if odd.in_world else np.eye(4)
    bound = np.concatenate([made.bind, np.eye(4)[None]]) if odd.root_joint else made.bind
    binds = buffer.add(np.linalg.inv(over @ bound).swapaxes(-1, -2).astype(np.float32))
    listed = [*range(joints + odd.root_joint)]  # the first node after the joints is right above the hips
    skins = [{"joints": listed, "inverseBindMatrices": binds}] * odd.skins
    meshes = [{"primitives": [_boxes(buffer, made, part, odd)]} for part in range(odd.skins)]
    scene = [top]
    for skin in range(odd.skins):
        scene.append(len(nodes))
        nodes.append({"name": f"mesh {skin}", "mesh": skin, "skin": skin})
    if odd.second:  # a child that looks on
        first = len(nodes)
        for joint, (name, parent) in enumerate(zip(NAMES, HUMANOID.parents, strict=True)):
            nodes.append({"name": f"other:{name}", "translation": (0.6 * odd.body[joint]).tolist()})
            if parent >= 0:
                nodes[first + parent].setdefault("children", []).append(first + joint)
        nodes[first]["translation"][0] += 3.0
        scene.append(first)
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": scene}],
        "nodes": nodes,
        "meshes": meshes,
        "skins": skins,
    }
    if odd.animated:
        clock = buffer.add(np.array([0, 1], np.float32), bounds=True)
        output = buffer.add(np.array([[0, 0, 0, 1], [0, 1, 0, 0]], np.float32))
        sampler = {"input": clock, "output": output}
        channel = {"sampler": 0, "target": {"node": 0, "path": "rotation"}}
        document["animations"] = [{"name": "spin", "samplers": [sampler], "channels": [channel]}]
    if odd.is_vrm:
        bones = {bone: {"node": joint} for bone, joint in made.bones.items()}
        document["extensionsUsed"] = ["VRMC_vrm"]
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    data = bytes(buffer.data)
    document |= {"bufferViews": buffer.views, "accessors": buffer.accessors, "buffers": [{"byteLength": len(data)}]}
    return container(document, data)


def _boxes(buffer: Buffer, made: Built, part: int, odd: Odd) -> dict[str, Any]:
    """Boxes around the bones, in the bind pose: upper ones in the first skin, lower ones in the second."""
    points, owners = [], []
    size = float(np.cbrt(np.linalg.det(odd.baked)))
    turn = odd.baked / size
    for bone, joint in made.bones.items():
        is_low = any(name in bone for name in ("Leg", "Foot", "Toes"))
        if odd.skins == 2 and is_low != bool(part):
            continue
        is_thick = bone in ("hips", "spine", "chest", "upperChest", "head")
        box = ROUND * [0.28, 0.18, 0.2] if is_thick else CORNERS * [0.05, 0.02, 0.05]
        placed = made.stretched[joint][:3, 3] + size * box @ turn.T
        moved = made.bind[joint] @ np.linalg.inv(made.stretched[joint])
        moved = odd.over @ moved if odd.in_world else moved
        points.append(placed @ moved[:3, :3].T + moved[:3, 3])
        owners += [joint] * len(box)
    positions = np.concatenate(points).astype(np.float32)
    joints, weights = np.zeros((len(positions), 4), np.uint8), np.zeros((len(positions), 4), np.float32)
    joints[:, 0], weights[:, 0] = owners, 1
    attributes = {
        "POSITION": buffer.add(positions, bounds=True),
        "JOINTS_0": buffer.add(joints),
        "WEIGHTS_0": buffer.add(weights),
    }
    triangles = np.concatenate([TRIANGLES + 24 * k for k in range(len(positions) // 24)]).astype(np.uint16)
    return {"attributes": attributes, "indices": buffer.add(triangles)}


def _parts(matrix: Array) -> dict[str, list[float]]:
    """Translation, rotation and scale; a matrix where it mirrors."""
    if np.linalg.det(matrix[:3, :3]) < 0:
        return {"matrix": matrix.T.reshape(-1).tolist()}
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    turn = quaternion_from_matrix(matrix[:3, :3] / scale)
    return {"translation": matrix[:3, 3].tolist(), "rotation": turn[[1, 2, 3, 0]].tolist(), "scale": [float(scale)] * 3}


def bvh(odd: Odd, path: Path) -> None:
    """The rig as a BVH, whose joints have no axes, scales or bind pose."""
    made = built(replace(odd, axes=None, bind="", scales=np.ones(len(NAMES))))
    order, slot = [], {}
    waiting = [0]
    while waiting:
        joint = waiting.pop()
        slot[joint] = len(order)
        order.append(joint)
        waiting += [child for child, parent in enumerate(made.parents) if parent == joint]
    places = made.rest[:, :3, 3]
    offsets = [places[joint] - (places[made.parents[joint]] if joint else places[0]) for joint in order]
    config = SkeletonConfig(
        names=tuple(made.names[joint].replace(" ", "_") for joint in order),
        parents=tuple(slot[made.parents[joint]] if joint else -1 for joint in order),
        offsets=tuple(map(tuple, np.array(offsets).tolist())),
    )
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (1, len(order), 1))
    write_bvh(path, Skeleton(config), still, np.zeros((1, 3), np.float32), 30, stand=Stand(metres=1.0))
