"""Read the rig of a character from a GLB or VRM file, and its skinned mesh as `measure_body` needs it.

Bones are found by the humanoid map of VRM 1.0 or 0.x, or in a plain GLB as `kinematics.rigs` finds them. The rig is the
subtree of the hips. It is measured in the space in which the hips move, so nothing above them matters: an armature
may be moved, turned, scaled or mirrored. It becomes a skeleton whose rest pose has no rotations, in metres, Y up,
facing +Z, its hips above the origin. That pose is the one in which the mesh was bound to the bones, if the file says
so, because the nodes may stand in the middle of an animation; or else the nodes' own.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.errors import MotionError
from echoavatar.limits import JOINTS, PRIMITIVES, SKIN_JOINTS, VERTICES

from ..kinematics import Skeleton, SkeletonConfig, SkinWeights
from ..kinematics.alignment import has_rest_pose
from ..kinematics.joint_tree import REQUIRED, Tree, with_parents
from ..kinematics.retarget import PlainRig, plain_rig
from ..kinematics.rigs import BONES, JointMap, check_bones, feet_of, find_bones
from ..kinematics.skeleton import numbered, summed, triples
from ..kinematics.upright import MIRRORED, axes_of, height, metres_of
from .gltf_data import Gltf, read_chunks, refusing_damage
from .gltf_nodes import above, binds_of, node_matrix, parents_of, unscaled, worlds_of
from .reading import reading

Array = np.ndarray
_SAME = 0.02  # radians, about: poses that differ by less are the same
_OLD_THUMB = {"Proximal": "Metacarpal", "Intermediate": "Proximal", "Distal": "Distal"}  # VRM 0.x to 1.0
_RIGID = 6  # bones that have a part of their own, where nothing is skinned
_EVEN = 1.002  # how much larger than its smallest the largest scale of a joint with children may be


@dataclass(frozen=True)
class GltfRig(Gltf):
    """A file and what was found in it."""

    order: list[int]  # the node of each joint of the skeleton
    parents: dict[int, int]  # the parent of every node, -1 for the topmost
    matrices: Float[Array, "n 4 4"]  # of every node, as the nodes stand, in the space in which the hips move
    skeleton: Skeleton
    frames: Float[Array, "j 3 3"]  # the axes of each joint's node in the skeleton's rest pose; they may be mirrored
    turn: Float[Array, "3 3"]  # from the axes of the hips' space to ours; it may mirror
    unit: float  # metres in a unit of the hips' space

    def place(self, node: int) -> Float[Array, "3"]:
        """Where a node stands in the file, metres in our axes, from the origin of the hips' space."""
        place: Array = self.unit * self.turn @ self.matrices[node][:3, 3]
        return place


def read_gltf_rig(path: Path, given: JointMap | None = None) -> GltfRig:
    """Read a glTF file of a character or of motion; `given` is the user's map of its bones.

    Raises:
        MotionError: the file is missing, damaged, no glTF, has no bones, or its bones are not found.
        DependencyError: the file is compressed, and the package that unpacks it is missing.
    """
    # values that are not finite are refused below
    with reading(path) as notes, refusing_damage(path), np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        return _read(path, given, notes)


def _read(path: Path, given: JointMap | None, notes: list[str]) -> GltfRig:
    file = read_chunks(path)
    document = file.document
    # some programs write -1 for a missing index
    document["nodes"] = [{k: v for k, v in node.items() if v != -1} for node in document["nodes"]]
    parents = parents_of(document["nodes"])
    worlds = worlds_of({node: node_matrix(document["nodes"][node]) for node in parents}, parents)
    order, bones, names = _rig(file, parents, worlds, given, notes)
    spaces = [*(worlds[node] for node in above(parents, order[0])), np.eye(4)]
    try:
        matrices = np.linalg.inv(spaces[0]) @ worlds
    except np.linalg.LinAlgError as error:
        raise MotionError("a node above its hips is scaled to nothing; scale it") from error
    if not np.isfinite(matrices).all():
        raise ValueError("nodes in places that are not finite")
    slot = {node: index for index, node in enumerate(order)}
    layout = _Layout(matrices[order], [-1, *(slot[parents[node]] for node in order[1:])], bones)
    if uneven := layout.uneven():
        raise MotionError(
            f"{names[uneven]} is scaled by more in one direction than in another, so what hangs from it would"
            " be sheared when it moves; apply its scale and export it again"
        )
    bound = list(islice(_bound(file, order, layout), 1))
    axes = [unscaled(np.linalg.inv(spaces[0]) @ space) for space in spaces]
    scale = float(np.cbrt(abs(np.linalg.det(spaces[0][:3, :3]))))
    turn = layout.axes(layout.stands, [*axes, *(made for _, made in bound)])
    poses = [
        layout.axes(frames, layout.nearest([made, *axes], frames)) @ frames
        for frames, made in bound
        if np.abs(frames - layout.stands).max() > _SAME
    ]
    notes += [MIRRORED] if np.linalg.det(turn) < 0 else []
    unit = metres_of(height(bones, matrices[order, :3, 3]), scale)
    for frames in [*poses, turn @ layout.stands]:
        offsets = unit * layout.steps(frames)
        offsets[0] = [0, (unit * turn @ matrices[order[0]][:3, 3])[1], 0]
        config = SkeletonConfig(
            names=names, parents=tuple(layout.parents), offsets=triples(offsets), feet=tuple(feet_of(bones)), vrm=bones
        )
        if has_rest_pose(skeleton := Skeleton(config), bones):
            break
    return GltfRig(path, document, file.data, order, parents, matrices, skeleton, frames, turn, unit)


class _Layout:
    """How the joints of a rig lie in the space in which the hips move."""

    def __init__(self, matrices: Float[Array, "j 4 4"], parents: list[int], bones: dict[str, int]) -> None:
        self.parents, self.bones, self.matrices = parents, bones, matrices
        self.stands = unscaled(matrices)
        places = matrices[:, :3, 3]
        steps = places - places[parents]
        self._steps = np.einsum("jab,ja->jb", self.stands[parents], steps)  # in the axes of the joint above
        self.core = with_parents(bones.values(), parents)

    def steps(self, frames: Float[Array, "j 3 3"]) -> Float[Array, "j 3"]:
        """From the parent to each joint, if the joints had these axes; 0 for the hips."""
        steps: Array = np.einsum("jab,jb->ja", frames[self.parents], self._steps)
        steps[0] = 0
        return steps

    def places(self, frames: Float[Array, "j 3 3"]) -> dict[str, Float[Array, "3"]]:
        """Positions of the bones relative to the hips, if the joints had these axes."""
        places = summed(self.steps(frames), self.parents)
        return {bone: places[joint] for bone, joint in self.bones.items()}

    def axes(self, frames: Float[Array, "j 3 3"], spaces: list[Float[Array, "3 3"]]) -> Float[Array, "3 3"]:
        """The matrix from the axes of `frames` to ours."""
        return axes_of(self.places(frames), spaces, mirrored=bool(np.linalg.det(frames[0]) < 0))

    def nearest(self, spaces: list[Float[Array, "3 3"]], frames: Float[Array, "j 3 3"]) -> list[Float[Array, "3 3"]]:
        """The spaces, first those with an axis nearest to the trunk."""
        places = self.places(frames)
        trunk = places["head"] - (places["leftUpperLeg"] + places["rightUpperLeg"]) / 2
        return sorted(spaces, key=lambda space: -float(np.abs(trunk @ space).max()))

    def uneven(self) -> int:
        """A joint that shears what hangs from it; 0 for none."""
        above = [self.parents[joint] for joint in self.bones.values() if joint]
        sizes = np.linalg.svd(self.matrices[above, :3, :3], compute_uv=False)
        return next((at for at, size in zip(above, sizes, strict=True) if size[0] > _EVEN * size[2]), 0)


def _bound(file: Gltf, order: list[int], layout: _Layout) -> Iterator[tuple[Array, Array]]:
    """The bind pose of each skin that has a body's bones: the axes of the joints with the hips as they stand
    (j, 3, 3), and those of the mesh (3, 3).

    Joints below which there is no known bone keep the rotation to their parent that their nodes have.
    """
    required = {order[layout.bones[bone]] for bone in REQUIRED}
    stands, parents = layout.stands, layout.parents
    for number, skin in enumerate(file.document.get("skins", [])):
        if "inverseBindMatrices" not in skin or not required <= set(skin["joints"]):
            continue
        inverse = dict(zip(skin["joints"], binds_of(file, number), strict=True))
        to_hips = layout.matrices[0] @ inverse[order[0]]  # from the space of the mesh to that of the hips
        known = {joint: inverse[order[joint]] for joint in layout.core if order[joint] in inverse}
        if not all(np.isfinite(bind).all() and np.linalg.det(bind) for bind in known.values()):
            continue
        places = {joint: to_hips @ np.linalg.inv(bind) for joint, bind in known.items()}
        frames = stands.copy()
        for joint, parent in enumerate(parents[1:], start=1):
            turn = stands[parent].T @ stands[joint]
            frames[joint] = unscaled(places[joint]) if joint in places else frames[parent] @ turn
        steps = layout.steps(frames)
        for joint in places.keys() - {0}:  # bones must point where they did, and be mirrored as they were
            step = (places[joint] - places.get(parents[joint], places[joint]))[:3, 3]
            if step @ steps[joint] < 0.98 * np.linalg.norm(step) * np.linalg.norm(steps[joint]):
                break
            if np.linalg.det(frames[joint] @ stands[joint]) < 0:
                break
        else:
            yield frames, unscaled(to_hips)


def _rig(
    file: Gltf, parents: dict[int, int], worlds: Float[Array, "n 4 4"], given: JointMap | None, notes: list[str]
) -> tuple[list[int], dict[str, int], tuple[str, ...]]:
    """Nodes of the rig, hips first and parents before children; the index of each bone in that list; their names."""
    document = file.document
    skins, mapped = document.get("skins", []), _humanoid(document)
    if (entries := sum(len(skin["joints"]) for skin in skins)) > SKIN_JOINTS:
        raise ValueError(f"skins of {entries:,} joints, and at most {SKIN_JOINTS:,} are read")
    joints = {node for skin in skins for node in skin["joints"]} or (set() if mapped else set(parents))
    kept = with_parents(joints | set(mapped.values()), parents)
    if len(kept) > JOINTS:
        raise ValueError(f"{len(kept):,} joints, and at most {JOINTS:,} are read")
    nodes = [node for node in parents if node in kept]  # parents first
    names = numbered(str(document["nodes"][node].get("name") or f"joint {node}") for node in nodes)
    slot = {node: index for index, node in enumerate(nodes)}
    is_mirrored = np.median(np.linalg.det(worlds[nodes, :3, :3])) < 0  # by a node above
    places = worlds[nodes, :3, 3] * [-1 if is_mirrored else 1, 1, 1]
    tree = Tree(names, [slot.get(parents[node], -1) for node in nodes], places)
    bones = find_bones(tree, given, {bone: slot[node] for bone, node in mapped.items()})
    if not (mapped or given):  # a wig beside a body does not have the body's head
        tops = [joint for joint, node in enumerate(nodes) if node in joints and not joints & {*above(parents, node)}]
        parts = sorted((sorted(tree.below(top)) for top in tops), key=len, reverse=True)
        for part in parts if len(parts) > 1 else ():
            if len(part) >= len(REQUIRED) and (found := find_bones(tree.only(part))).keys() >= set(REQUIRED):
                bones = {bone: part[joint] for bone, joint in found.items()}
                break
    check_bones(names, bones)
    hips = bones["hips"]
    own = {joint: index for index, joint in enumerate(sorted(tree.below(hips)))}
    if apart := [bone for bone in REQUIRED if bones[bone] not in own]:
        raise MotionError(f"its {apart[0]} does not hang from its hips; check the nodes' children")
    taken = {*own, *tree.above(hips)}
    others = [joint for joint in range(len(nodes)) if joint not in taken]
    if others and not (mapped or given) and find_bones(tree.only(others)).keys() >= set(REQUIRED):
        notes.append(f"it holds several characters; the one with the hips {names[hips]!r} is read")
    kept_bones = {bone: own[joint] for bone, joint in bones.items() if joint in own}
    return [nodes[joint] for joint in own], kept_bones, tuple(names[joint] for joint in own)


def _humanoid(document: dict[str, Any]) -> dict[str, int]:
    """The map of a VRM, without entries that name no node; empty in other files."""
    extensions = document.get("extensions", {})
    if own := extensions.keys() & {"VRMC_vrm", "VRMC_vrm_animation"}:
        listed = extensions[own.pop()].get("humanoid", {}).get("humanBones", {}).items()
    else:
        entries = extensions.get("VRM", {}).get("humanoid", {}).get("humanBones", [])
        thumbs = [(entry, *entry["bone"].partition("Thumb")) for entry in entries]
        listed = [(stem + thumb + _OLD_THUMB.get(thumb and part, part), entry) for entry, stem, thumb, part in thumbs]
    nodes = range(len(document["nodes"]))
    return {bone: entry["node"] for bone, entry in listed if bone in BONES and entry.get("node", -1) in nodes}


class Skinned(NamedTuple):
    """A character in our rest pose, in metres, its hips above the origin."""

    skeleton: Skeleton
    vertices: Float[Array, "v 3"]
    weights: SkinWeights


def read_skinned(path: Path, given: JointMap | None = None) -> Skinned:
    """Read a glTF file of a character; raises what `read_gltf_rig` and `skinned` raise."""
    return skinned(read_gltf_rig(path, given))


def skinned(rig: GltfRig) -> Skinned:
    """The character in a file whose rig has been read, in our rest pose, as `plain_rig` gives it.

    Raises MotionError: the file has no skinned mesh, or its meshes are damaged or too large.
    """
    with refusing_damage(rig.path), np.errstate(invalid="ignore", over="ignore"):  # checked below
        owners = _owners(rig)
        held = {owners[node] for node, entry in enumerate(rig.document["nodes"]) if "mesh" in entry} - {-1}
        if not (rig.document.get("skins") or _humanoid(rig.document) or len(held) >= _RIGID):
            raise MotionError(
                f"{rig.path} has no skin, so nothing says which vertex follows which bone; export it rigged"
            )
        plain = plain_rig(rig.skeleton)
        vertices, weights = _skin(rig, plain)
        if not (np.isfinite(vertices).all() and np.isfinite(weights.shares).all()):
            raise ValueError("vertices or weights that are not finite")
    return Skinned(plain.skeleton, vertices, weights)


def _moves(rig: GltfRig, plain: PlainRig) -> Float[Array, "j 4 4"]:
    """For each joint, the matrix from the hips' space to our rest pose for the vertices that hang from it."""
    stands = rig.matrices[rig.order]
    moves = np.tile(np.eye(4), (len(stands), 1, 1))
    turns = plain.turns.swapaxes(-1, -2) @ rig.frames @ unscaled(stands).swapaxes(-1, -2)
    moves[:, :3, :3] = rig.unit * turns
    spots = plain.skeleton.rest_positions.astype(np.float64)
    moves[:, :3, 3] = spots - (moves[:, :3, :3] @ stands[:, :3, 3:])[..., 0]
    return moves


def _skin(rig: GltfRig, plain: PlainRig) -> tuple[Float[Array, "v 3"], SkinWeights]:
    """The skinned vertices of all meshes, and their weights on the rig's joints."""
    vertices, owners, shares = [], [], []
    for part in parts_of(rig, plain):
        own = part.is_own
        vertices.append(part.moved(part.places[own], own).astype(np.float32))
        owners.append(part.owners[part.joints[own]])
        shares.append(part.shares[own].astype(np.float32))
    if not sum(map(len, vertices)):
        raise MotionError(f"{rig.path}: none of its meshes is skinned; export the character with its skin weights")
    joints, share = np.concatenate(owners), np.concatenate(shares)
    for later in range(1, joints.shape[1]):  # two joints of a file may be one of the rig's
        for slot in range(later):
            same = joints[:, slot] == joints[:, later]
            share[same, slot] += share[same, later]
            share[same, later] = 0
    return np.concatenate(vertices), SkinWeights(joints, share)


BLOCK = 1 << 14  # vertices that are moved at once: a matrix for each influence takes half a kilobyte a vertex


class Part(NamedTuple):
    """A primitive of a mesh, and what it hangs from."""

    node: int
    entry: dict[str, Any]  # of the document
    places: Float[Array, "v 3"]  # in the file
    joints: Int[Array, "v 4"]  # index `moves` and `owners`
    shares: Float[Array, "v 4"]  # of the joints that are the character's
    moves: Float[Array, "k 4 4"]  # from the file to the pose
    owners: Int[Array, " k"]  # joints of the rig
    is_own: Bool[Array, " v"]  # whether a vertex hangs mostly from the character

    def moved(self, vectors: Float[Array, "v 3"], rows: Array, *, are_places: bool = True) -> Float[Array, "v 3"]:
        """Places, or else directions, in the pose; `rows` says at which of the primitive's vertices they are."""
        far = np.concatenate([vectors, np.full((len(vectors), 1), float(are_places))], 1)
        share, joints = self.shares[rows], self.joints[rows]
        blocks = [slice(start, start + BLOCK) for start in range(0, len(far), BLOCK)]
        moved = [np.einsum("vk,vkij,vj->vi", share[at], self.moves[joints[at]], far[at])[:, :3] for at in blocks]
        return np.concatenate(moved) if moved else far[:, :3]


def parts_of(rig: GltfRig, plain: PlainRig, *, has_rigid: bool = False) -> Iterator[Part]:
    """The primitives of all skinned meshes in the rest pose of `plain`; with `has_rigid` also of those without a skin.

    Where no mesh is skinned, the parts hang on the bones as they are. What hangs mostly from nodes of another tree,
    such as those of a second character, is not its own. Raises ValueError: the file is damaged.
    """
    owner, moves = _owners(rig), _moves(rig, plain)
    skins: dict[int, tuple[Array, Array]] = {}
    for node, skin, part in _drawn(rig.document, has_rigid):
        places = rig.attribute(part, "POSITION")
        if skin is None:
            joints, share = np.zeros((len(places), 4), int), np.tile([1.0, 0, 0, 0], (len(places), 1))
            known = np.array([owner[node] if rig.parents[node] >= 0 else 0], np.int32)  # loose parts go with the hips
            placed = moves[known] @ rig.matrices[[node]]
        else:
            if skin not in skins:
                bones = rig.document["skins"][skin]["joints"]
                known = np.array([owner[joint] for joint in bones], np.int32)
                skins[skin] = moves[known] @ rig.matrices[bones] @ binds_of(rig, skin), known
            placed, known = skins[skin]
            joints = rig.attribute(part, "JOINTS_0").astype(int)
            share = rig.attribute(part, "WEIGHTS_0")
        if share.shape[1] != 4:
            raise ValueError(f"{share.shape[1]} weights for a vertex, where the format has 4")
        share = share / np.maximum(share.sum(1, keepdims=True), 1e-9)
        own = np.where(known[joints] >= 0, share, 0)
        held_here = own.sum(1)
        own = own / np.maximum(held_here, 1e-9)[:, None]
        yield Part(node, part, places, joints, own, placed, np.maximum(known, 0), ~(held_here < 0.5))


def _drawn(document: dict[str, Any], has_rigid: bool) -> list[tuple[int, int | None, dict[str, Any]]]:
    """The node, the skin and each primitive of all skinned meshes, or of all meshes where none is skinned.

    Raises ValueError: there are more primitives or vertices than `limits` allows.
    """
    drawn = [(index, node) for index, node in enumerate(document["nodes"]) if "mesh" in node]
    skinned = [(index, node) for index, node in drawn if "skin" in node]
    found, primitives, vertices = [], 0, 0
    for index, node in drawn if has_rigid else skinned or ([] if document.get("skins") else drawn):
        parts = document["meshes"][node["mesh"]]["primitives"]
        primitives += len(parts)
        if primitives > PRIMITIVES:
            raise ValueError(f"meshes of {primitives:,} primitives, and at most {PRIMITIVES:,} are read")
        for part in parts:
            if "JOINTS_0" in part["attributes"] or not skinned or "skin" not in node:
                vertices += document["accessors"][part["attributes"]["POSITION"]]["count"]
                found.append((index, node.get("skin"), part))
            if vertices > VERTICES:
                raise ValueError(f"meshes of {vertices:,} vertices, and at most {VERTICES:,} are read")
    return found


def _owners(rig: GltfRig) -> dict[int, int]:
    """The rig's joint of each node: its own, or that of its nearest ancestor in the rig.

    Nodes above the hips belong to the hips; -1 stands for nodes of another tree.
    """
    slot, owner = {node: index for index, node in enumerate(rig.order)}, {-1: -1}
    for node, parent in rig.parents.items():  # parents first
        owner[node] = slot.get(node, owner[parent])
    return owner | dict.fromkeys(above(rig.parents, rig.order[0]), 0)
