"""How a figure stands in its file: unit, up and facing are measured on it, because most formats do not say them.

`measure` needs the rest pose alone. `of_clip` looks at the motion as well, because some programs turn the root of an
upright rest pose in every frame. `righted` gives the same motion in metres, Y up, facing +Z, and `placed` puts its hips
into the unit of its bones. `axes_of` and `metres_of` serve glTF, whose nodes say how a figure may lean and which unit
is meant. Both find the axes by `_standing`.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError

from .joint_tree import SIDES
from .motion import Motion
from .rotations import quaternion_from_matrix, quaternion_multiply, unit
from .skeleton import Skeleton

UNITS = (  # name, metres, and the heights in metres that make it the likely one; the first that fits is taken
    ("centimetres", 0.01, 0.81, 3.1),  # from a small child to the giants of games
    ("metres", 1.0, 0.5, 3.1),
    ("millimetres", 0.001, 1.0, 3.0),
    ("inches", 0.0254, 1.48, 2.06),
    ("units of 5.64 cm, as CMU's recordings have", 0.0564444, 1.48, 2.06),
    ("centimetres", 0.01, 0.5, 3.0),
    ("inches", 0.0254, 0.5, 3.0),
    ("feet", 0.3048, 1.48, 2.06),
    ("metres", 1.0, 0.3, 10.0),
    ("centimetres", 0.01, 0.3, 10.0),
    ("decimetres", 0.1, 1.0, 3.1),
    ("tens of metres", 10.0, 1.0, 3.0),
    ("hundreds of metres", 100.0, 1.0, 3.0),
)
MIRRORED = "it is mirrored, because its left side is on the right where its toes point ahead"
_TALL = 1.21  # a person's height over the length of trunk, neck, thigh and shin
_STANDING = 0.5  # cosine: trunk and legs of a standing figure are nearer to the vertical
_CLEAR = 0.75  # cosine: a direction that belongs to one axis
_FLOOR = 0.2  # of the height: a floor at 0 is not farther from the lower foot
_LYING = (0.02, 0.35)  # of the height: how high over a floor at 0 the hips of a lying figure are
_LEANING, _TURNED = 0.94, 0.99998  # cosines of 20 and of 0.36 degrees: how far up and side may be off a frame's axes
_ANYONE, _MEAN = (0.5, 3.0), 1.7  # heights of people, metres
_SAME = 2.99  # trace of a turn by 6 degrees; smaller turns are not reported
_MOSTLY, _FASTEST = 0.9, 10.0  # share of the time; body heights a second, faster than anybody moves
_TIMES, _NEAR = (10.0, 100.0, 1000.0), 1.15  # by which hip positions may be too large, and the tolerance of the test
_LOW, _SUNK = 0.1, 0.25  # share of the time in which feet touch the floor; of the height: no deeper are feet in it
_BEHIND = 0.04  # of the length of a leg: toes so far behind the feet, both together, belong to a mirrored figure
_SAMPLES = 64  # frames of a clip that are looked at
_NEEDED = {"hips", "head"} | {s + bone for s in SIDES for bone in ("UpperArm", "UpperLeg", "LowerLeg", "Foot")}
_Vector = Float[np.ndarray, "3"]
_Turn = Float[np.ndarray, "3 3"]


class Stand(NamedTuple):
    """The turns and the scale from a file's axes and unit to ours; rest pose and world may need different turns."""

    rest: _Turn = np.eye(3)  # both may mirror
    world: _Turn = np.eye(3)
    metres: float = 0.01  # of one unit
    tall: float = 0.0  # the figure's height, metres; 0 where it is not known

    def notes(self, usual: float = 0.01) -> list[str]:
        """The assumptions, in words."""
        rest, world = (np.trace(turn) < _SAME for turn in (self.rest, self.world))
        what = "it" if rest and world else "its rest pose" if rest else "its motion"
        notes = [f"{what} is turned to Y up, facing +Z"] if rest or world else []
        if np.linalg.det(self.rest) < 0:
            notes = [MIRRORED]
        if self.metres != usual:
            name = next((name for name, metres, *_ in UNITS if metres == self.metres), f"{self.metres:.3g} m")
            notes.append(f"its unit is taken for {name}, so that the figure is {self.tall:.2f} m tall")
        return notes


OURS = Stand()  # in centimetres


def measure(bones: Mapping[str, int], places: Float[np.ndarray, "j 3"], usual: float = 0.01) -> Stand:
    """How a rest pose stands: its joints are at `places`, in the file's axes and unit.

    A figure that leans is not straightened, and one that does not stand is not turned. The unit is `usual` (metres)
    where the bones that tell are missing.
    """
    if _NEEDED - bones.keys() or not np.isfinite(places).all() or not (tall := height(bones, places)):
        return Stand(metres=usual)
    at = {bone: places[joint].astype(np.float64) for bone, joint in bones.items()}
    metres = metres_of(tall)
    lines = [unit(at["head"] - at["hips"]), *(unit(at["hips"] - at[f"{side}Foot"]) for side in SIDES)]
    up = _nearest(np.eye(3), np.sum(lines, axis=0))
    if min(up @ line for line in lines) < _STANDING:
        return Stand(metres=metres, tall=tall * metres)
    hips, shoulders = (at[f"left{bone}"] - at[f"right{bone}"] for bone in ("UpperLeg", "UpperArm"))
    ahead = np.cross(hips, up)
    is_plain = ahead.any() and shoulders @ hips >= 0  # no twisted figure
    turn = _standing(at, hips, [(np.eye(3), up)]) if is_plain else _lifted(up)
    return Stand(turn, turn, metres, tall * metres)


def height(bones: Mapping[str, int], places: Float[np.ndarray, "j 3"]) -> float:
    """How tall the figure would stand, in the unit of `places`: the lengths of its bones tell it in any pose."""
    spine = [bone for bone in ("hips", "spine", "chest", "upperChest", "neck", "head") if bone in bones]
    leg = ["leftUpperLeg", "leftLowerLeg", "leftFoot"]
    chains = (np.array([places[bones[bone]] for bone in chain], np.float64) for chain in (spine, leg))
    return _TALL * sum(float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum()) for chain in chains)


def of_clip(motion: Motion, bones: Mapping[str, int], *, has_floor: bool = True) -> Stand:
    """As `measure`, for a clip in its file's axes and unit; the motion tells which axis of its world is up.

    Where the floor may be at 0 (`has_floor`), a body that lies there is not stood up.
    """
    stand = measure(bones, motion.skeleton.rest_positions)
    if not stand.tall:
        return stand
    tall = stand.tall / stand.metres
    places = _seen(motion)
    if np.linalg.det(stand.rest) < 0 and _faces_toes(bones, places, stand.rest[1]):  # the rest pose alone is twisted
        stand = stand._replace(rest=_lifted(stand.rest[1]), world=_lifted(stand.rest[1]))
    feet = places[:, [bones["leftFoot"], bones["rightFoot"]]]
    mean = unit(places[:, bones["head"]] - feet.mean(1)).mean(0)
    axis, usual = _nearest(np.eye(3), mean), stand.rest[1]
    if axis @ mean < _CLEAR or axis @ usual > _STANDING:
        return stand
    stands = abs(np.median((feet @ axis).min(1))) < _FLOOR * tall
    hips, lowest = np.median(places[:, bones["hips"]] @ usual), np.median((places @ usual).min(1))
    lies = _LYING[0] * tall < hips < _LYING[1] * tall and lowest > -_FLOOR * tall
    world = _lifted(axis) * [[1], [1], [np.sign(np.linalg.det(stand.rest))]]
    return stand._replace(world=world) if stands or not lies or not has_floor else stand


def _seen(motion: Motion) -> Float[np.ndarray, "t j 3"]:
    """Positions of the joints in up to `_SAMPLES` frames."""
    seen = np.unique(np.linspace(0, motion.frames - 1, _SAMPLES).astype(int))
    some = Motion(motion.skeleton, motion.rotations[seen], motion.root[seen], motion.fps)
    return some.pose(np.float64).positions


def _faces_toes(bones: Mapping[str, int], places: Float[np.ndarray, "t j 3"], up: _Vector) -> bool:
    """Whether most of the time the toes are ahead of hips whose left is left."""
    at = {bone: places[:, joint] for bone, joint in bones.items()}
    ahead = np.cross(at["leftUpperLeg"] - at["rightUpperLeg"], up)
    return bool(np.median(np.sum(_toes(at) * ahead, -1)) > 0)


def placed(motion: Motion, bones: Mapping[str, int], notes: list[str]) -> Motion:
    """A motion in metres, Y up, above the floor, its hips in the unit of its bones; `notes` say what changed.

    Some programs scale the bones and not the keys, so that the hips fly a hundred times as high as the legs are long.
    Others write no height: the hips stay at 0.
    Raises MotionError: it moves faster than any body, because its places have some other unit.
    """
    if _NEEDED - bones.keys() or not (tall := height(bones, motion.skeleton.rest_positions)):
        return motion
    places = _seen(motion)[:, [bones["hips"], bones["leftFoot"], bones["rightFoot"]], 1]
    leg, high = np.median(places[:, 0] - places.min(1)), np.median(places[:, 0])
    if times := next((times for times in _TIMES if leg / _NEAR < high / times < leg * _NEAR), 0.0):
        notes.append(f"its hips are {times:g} times as high as its legs are long, and their places are divided by that")
        motion = Motion(motion.skeleton, motion.rotations, motion.root / np.float32(times), motion.fps)
        places = places / times
    if (low := float(np.quantile(places[:, 1:].min(1), _LOW))) < -_SUNK * tall:
        notes.append(f"its feet are {-low:.2f} m below the floor, and it is lifted onto it")
        rest = motion.skeleton.rest_positions[:, 1]
        sole = rest[[bones["leftFoot"], bones["rightFoot"]]].mean() - rest.min()
        lift = np.array([0, sole - low, 0], np.float32)
        motion = Motion(motion.skeleton, motion.rotations, motion.root + lift, motion.fps)
    speeds = np.linalg.norm(np.diff(motion.root.astype(np.float64), axis=0), axis=1) * motion.fps / tall
    if speeds.size and (speed := float(np.quantile(speeds, _MOSTLY))) > _FASTEST:
        raise MotionError(f"its hips move {speed:.0f} times its height a second; give places in the unit of its bones")
    return motion


def righted(motion: Motion, stand: Stand) -> Motion:
    """The motion in metres, Y up and, at rest, facing +Z."""
    return turned(motion, stand.rest, stand.world, stand.metres)


def turned(motion: Motion, rest: _Turn, world: _Turn, scale: float = 1.0) -> Motion:
    """The motion with its rest pose and its world turned, each by a matrix of its own, and scaled. Both may mirror."""
    config, rotations = motion.skeleton.config, motion.rotations
    offsets = np.array(config.offsets) @ rest.T * scale
    offsets[0] = np.array(config.offsets[0]) @ world.T * scale
    tips = {name: np.array(tip) @ rest.T * scale for name, tip in config.tips.items()}
    if not np.array_equal(rest, np.eye(3)):
        axes = np.linalg.det(rest) * rest.T  # of a turn, which goes the other way in a mirror
        rotations = np.concatenate([rotations[..., :1], rotations[..., 1:] @ axes.astype(np.float32)], -1)
    if not np.array_equal(rest, world):
        first = quaternion_from_matrix(world @ rest.T)
        root = quaternion_multiply(first, rotations[:, 0].astype(np.float64))
        rotations = np.concatenate([root[:, None].astype(np.float32), rotations[:, 1:]], 1)
    root = motion.root.astype(np.float64) @ world.T * scale
    return Motion(motion.skeleton.with_offsets(offsets, tips), rotations, root.astype(np.float32), motion.fps)


def axes_of(places: Mapping[str, _Vector], frames: Sequence[_Turn] = (np.eye(3),), *, mirrored: bool = False) -> _Turn:
    """The matrix from the rig's axes to ours (Y up, facing +Z, left +X); for a mirrored rig it has a mirror in it.

    A head is not exactly above the hips, so what is measured is snapped to axes of `frames` (columns): of the first
    with axes near up and left, else of the first with one near up. If there is none, the measured directions stay.
    A rig is mirrored if its toes point back where left is left; `mirrored` says it of a rig without toes. Raises
    MotionError: the hips, the head and the two sides do not lie as a body's.
    """
    line = [places[bone] for bone in ("leftFoot", "leftLowerLeg", "leftUpperLeg", "head")]
    size = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    trunk = places["head"] - (places["leftUpperLeg"] + places["rightUpperLeg"]) / 2
    ways = [places[f"left{bone}"] - places[f"right{bone}"] for bone in ("UpperLeg", "UpperArm")]
    across = next((way for way in ways if np.linalg.norm(np.cross(way, unit(trunk))) > 0.02 * size), None)
    if across is None or not np.linalg.norm(trunk) > 0.1 * size:
        raise MotionError("its rest pose is no body's: head and hips, or left and right, are in one place; pose it")
    ups = [(frame, _nearest(frame, trunk)) for frame in frames]
    near = [(frame, up) for frame, up in ups if up @ unit(trunk) > _LEANING]
    return _standing(places, across, near or [(np.zeros((3, 3)), unit(trunk))], mirrored=mirrored)


def _standing(
    places: Mapping[str, _Vector], across: _Vector, ups: Sequence[tuple[_Turn, _Vector]], *, mirrored: bool = False
) -> _Turn:
    """The matrix to our axes of a body whose left is `across`, by the first of `ups` whose frame has that axis."""
    lefts = [unit(across - (across @ up) * up) for _, up in ups]
    sides = [_nearest(frame, left) for (frame, _), left in zip(ups, lefts, strict=True)]
    best = next((k for k, (side, left) in enumerate(zip(sides, lefts, strict=True)) if side @ left > _TURNED), -1)
    left, up = (lefts[0], ups[0][1]) if best < 0 else (sides[best], ups[best][1])
    toes, leg = _toes(places) @ np.cross(left, up), [places[f"left{bone}"] for bone in ("UpperLeg", "LowerLeg", "Foot")]
    is_far = abs(toes) > _BEHIND * np.linalg.norm(np.diff(leg, axis=0), axis=1).sum()
    is_mirrored = toes < 0 if is_far else mirrored
    return np.stack([left, up, np.cross(left, up) * (-1 if is_mirrored else 1)])


def _toes(places: Mapping[str, _Vector]) -> _Vector:
    """The sum of both vectors from foot to toes; 0 without toes."""
    toes = [places[f"{side}Toes"] - places[f"{side}Foot"] for side in SIDES if f"{side}Toes" in places]
    return np.sum(toes, axis=0) if toes else np.zeros(3)


def metres_of(tall: float, stated: float = 0.0) -> float:
    """Metres in a unit: `stated` if the figure is then as tall as people, else the likeliest, else 1.7 / `tall`."""
    likely = (unit for _, unit, least, most in (("", stated, *_ANYONE), *UNITS) if least <= tall * unit <= most)
    return next(likely, _MEAN / tall)


def scaled(skeleton: Skeleton, factor: float) -> Skeleton:
    """The rig, `factor` times as large."""
    return turned(Motion.at_rest(skeleton), np.eye(3), np.eye(3), factor).skeleton


def _lifted(up: _Vector) -> _Turn:
    """The turn that takes an axis to +Y the short way: +Z up faces -Y, as in Blender, -Y up -Z, as a camera sees it."""
    if up[1]:
        return np.diag([1.0, up[1], up[1]])
    axis = np.cross(up, [0, 1, 0])
    return np.outer(axis, axis) + np.outer([0, 1, 0], up) - np.outer(up, [0, 1, 0])


def _nearest(frame: _Turn, way: _Vector) -> _Vector:
    """The axis of a frame, positive or negative, that is nearest to a direction."""
    axes = np.concatenate([frame.T, -frame.T])
    nearest: np.ndarray = axes[np.argmax(axes @ way)]
    return nearest
