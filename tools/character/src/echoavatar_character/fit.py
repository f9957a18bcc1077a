"""Bring a person of the base mesh onto the bones of `HUMANOID` in its T-pose.

`HUMANOID` is posed as the base mesh stands (arms lowered, elbows bent); each bone of the mesh is then moved and
stretched onto the posed bone, and the pose is undone by the inverse of linear blend skinning. Whoever skins the result
with the same weights gets the modelled shape back in the modelled pose, and the shoulders of lowered arms are those
of the sculptor.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.files.avatar import halfway
from echoavatar.files.avatar.halfway import with_halfway
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics

from .base import bone_ends, bone_weights

REST = HUMANOID.rest_positions.astype(np.float64)
NAMES = HUMANOID.names
PARENTS = HUMANOID.parents
SOLE = 0.013  # metres between floor and foot: the sole of a shoe
# Our rig has a long neck and high shoulders. The mesh's joints lie below ours by this much (metres), and collar bones
# follow the mesh's slope by this share only, or a person would seem to shrug.
LOWER = {"neck": 0.012, "head": 0.043, "leftUpperArm": 0.029, "rightUpperArm": 0.029}
COLLAR = 0.4
HEAD_SIZE = 1.13


class Fit(NamedTuple):
    """Maps of a person's space: `posed` to the modelled pose on our bones, `rest` from there to the T-pose."""

    scale: float
    posed: Float[np.ndarray, "j 3 4"]
    pose: Float[np.ndarray, "b 3 4"]  # of all `BONES`, from T-pose to the modelled pose
    rotations: Float[np.ndarray, "j 3 3"]  # of the modelled pose, relative to the parent
    root: Float[np.ndarray, " 3"]


def weights_matrix() -> Float[np.ndarray, "v j"]:
    """Skin weights of all vertices of the base mesh over the joints of `HUMANOID`; rows sum to 1."""
    columns = bone_weights()
    table = np.stack([columns[name] for name in NAMES], 1)
    table[table.sum(1) < 1e-6, NAMES.index("head")] = 1
    return np.asarray(table / table.sum(1, keepdims=True))


def fit(shape: Float[np.ndarray, "v 3"]) -> Fit:
    """How the bones of a person's shape meet ours."""
    heads = {name: shape[ends[0]].mean(0) for name, ends in bone_ends().items()}
    tails = {name: shape[ends[1]].mean(0) for name, ends in bone_ends().items()}
    floor = shape[:13380, 1].min()
    scale = (REST[NAMES.index("head"), 1] - SOLE) / (heads["head"][1] - floor)
    world = _pose(heads, tails)
    local = np.stack([world[j] if p < 0 else world[p].T @ world[j] for j, p in enumerate(PARENTS)])
    made = forward_kinematics(HUMANOID, local.astype(np.float32), REST[0].astype(np.float32))
    placed = made.positions.astype(np.float64)
    goals = placed - np.array([[0.0, LOWER.get(name, 0.0), 0.0] for name in NAMES])
    posed = np.zeros((len(NAMES), 3, 4))
    for j, name in enumerate(NAMES):
        linear = scale * np.eye(3)
        child = _child(j)
        if name.endswith("Foot") or name.endswith("Toes"):
            foot = name.replace("Toes", "Foot")
            tall = (REST[NAMES.index(foot), 1] - SOLE) / (scale * (heads[foot][1] - floor))
            linear = scale * np.diag([1, tall, 1])
        elif name == "head":
            linear = linear * HEAD_SIZE
        elif child is not None:
            along = heads[NAMES[child]] - heads[name]
            wanted = goals[child] - goals[j]
            length = np.linalg.norm(along)
            d = along / length
            stretch = np.linalg.norm(wanted) / (scale * length)
            linear = scale * (np.eye(3) + (stretch - 1) * np.outer(d, d))
        elif "Distal" in name:
            linear = posed[PARENTS[j], :, :3]
        posed[j, :, :3] = linear
        posed[j, :, 3] = goals[j] - linear @ heads[name]
    turned, places = with_halfway(made.rotations.astype(np.float64), placed)
    pose = np.concatenate([turned, (places - np.einsum("jik,jk->ji", turned, halfway.REST))[:, :, None]], 2)
    return Fit(float(scale), posed, pose, local, REST[0])


def posed(fitted: Fit, points: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"]) -> Float[np.ndarray, "v 3"]:
    """Points of the person on our bones, in the modelled pose."""
    maps = np.einsum("vj,jik->vik", weights, fitted.posed)
    return np.asarray(np.einsum("vik,vk->vi", maps[:, :, :3], points) + maps[:, :, 3])


def to_rest(
    fitted: Fit, points: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v b"]
) -> Float[np.ndarray, "v 3"]:
    """Points of the modelled pose in the T-pose; weights are over all `BONES`."""
    maps = np.einsum("vj,jik->vik", weights, fitted.pose)
    return np.linalg.solve(maps[:, :, :3], (points - maps[:, :, 3])[..., None])[..., 0]


def _child(joint: int) -> int | None:
    """The joint that a bone points to."""
    name = NAMES[joint]
    if name.endswith("Hand"):
        return NAMES.index(name.replace("Hand", "MiddleProximal"))
    if name in ("hips", "upperChest"):
        return NAMES.index({"hips": "spine", "upperChest": "neck"}[name])
    found = [i for i, parent in enumerate(PARENTS) if parent == joint]
    return found[0] if found else None


def _pose(heads: dict[str, np.ndarray], tails: dict[str, np.ndarray]) -> Float[np.ndarray, "j 3 3"]:
    """World rotations of our joints in the pose of the mesh."""
    world = np.tile(np.eye(3), (len(NAMES), 1, 1))
    for side in ("left", "right"):
        joint = {part: NAMES.index(side + part) for part in ("UpperArm", "LowerArm", "Hand", "Foot", "Toes")}
        at = {name[len(side) :]: place for name, place in heads.items() if name.startswith(side)}
        upper, fore = at["LowerArm"] - at["UpperArm"], at["Hand"] - at["LowerArm"]
        out = REST[joint["LowerArm"]] - REST[joint["UpperArm"]]
        hinge, rest_hinge = np.cross(upper, fore), np.cross(out, [0, 0, 1])
        shoulder = NAMES.index(side + "Shoulder")
        ours = _unit(REST[joint["UpperArm"]] - REST[shoulder])
        world[shoulder] = _swing(ours, (1 - COLLAR) * ours + COLLAR * _unit(at["UpperArm"] - at["Shoulder"]))
        world[joint["UpperArm"]] = _frame(upper, hinge) @ _frame(out, rest_hinge).T
        world[joint["LowerArm"]] = _frame(fore, hinge) @ _frame(out, rest_hinge).T
        palm = [side + finger + "Proximal" for finger in ("Index", "Middle", "Ring", "Little")]
        ours = REST[[NAMES.index(name) for name in palm]] - REST[joint["Hand"]]
        theirs = np.stack([heads[name] for name in palm]) - at["Hand"]
        world[joint["Hand"]] = _rotation(ours, theirs)
        for finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
            chain = [i for i, name in enumerate(NAMES) if name.startswith(side + finger)]
            for j in chain:
                parent = PARENTS[j]
                next_joint = _child(j)
                if next_joint is None:
                    ours_along = REST[j] - REST[parent]
                    theirs_along = tails[NAMES[j]] - heads[NAMES[j]]
                else:
                    ours_along = REST[next_joint] - REST[j]
                    theirs_along = heads[NAMES[next_joint]] - heads[NAMES[j]]
                world[j] = _swing(world[parent] @ ours_along, theirs_along) @ world[parent]
        for part, end in (("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")):
            a, b = NAMES.index(side + part), NAMES.index(side + end)
            world[a] = _swing(REST[b] - REST[a], at[end] - at[part])
        heading = at["Toes"] - at["Foot"]
        world[joint["Foot"]] = world[joint["Toes"]] = _swing(np.array([0, 0, 1.0]), heading * [1, 0, 1])
    return world


def _unit(a: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return np.asarray(a / np.linalg.norm(a))


def _swing(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation of direction a onto direction b."""
    a, b = _unit(a), _unit(b)
    v, c = np.cross(a, b), float(a @ b)
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + c))


def _frame(along: Float[np.ndarray, " 3"], hinge: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    x = _unit(along)
    y = _unit(hinge - x * (hinge @ x))
    return np.stack([x, y, np.cross(x, y)], 1)


def _rotation(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that brings vectors a closest to b."""
    u, _, vt = np.linalg.svd(b.T @ a)
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)
