"""Read BVH, the common format of captured motion: any hierarchy, any channel order.

The format has no standard. What programs write is read, and one warning says what was assumed, for example about the
count of frames or the encoding. Unit and axes are measured on the figure (`kinematics.upright`).

Joints below the root may have position channels. If the child that has the whole body travels (as in the Bandai-Namco
data, or in files of Unreal beside IK targets), the root is merged into it. Elsewhere bones count as rigid, and their
mean length is used.
"""

import re
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echoavatar.errors import MotionError
from echoavatar.limits import (
    BVH_BYTES,
    BVH_LINE,
    BVH_LINES,
    DEPTH,
    JOINTS,
    ROTATIONS,
    STILL_ROTATIONS,
    check_file,
    decoded,
    readable,
)

from ..kinematics.motion import Motion, usual_rate
from ..kinematics.rigs import JointMap, known_bones, with_bones
from ..kinematics.rotations import matrix_from_quaternion, quaternion_multiply, unit
from ..kinematics.skeleton import Skeleton, SkeletonConfig, numbered, triples
from ..kinematics.upright import Stand, of_clip, placed, righted
from .reading import reading

_RIGID = 2e-3  # of the longest bone: a bone that changes its length by more is reported
_MOST = 1e12  # numbers in a file must be smaller, so that no sum of squares overflows
_BESIDE = 0.1  # of the length of a joint's OFFSET: smaller mean positions are relative to the OFFSET
_ARMS = (("rightUpperArm", "leftUpperArm"), ("leftUpperArm", "leftLowerArm"), ("rightUpperArm", "rightLowerArm"))
_STANDING = (("hips", "head"), ("leftUpperLeg", "leftFoot"), ("rightUpperLeg", "rightFoot"))
_ALONG, _MOVING = 0.5, 0.05  # least cosine of directions that agree; radians that angles of a moving body change
_ASSUMED_HZ = 30.0
_LONGEST_S = 2.0  # between frames; a longer time would be milliseconds
_WHOLE_HZ = (24, 25, 30, 50, 60, 90, 100, 120, 15, 10, 12, 20, 48, 72, 144, 200, 240)  # the likely ones first
_RATES_HZ = (*_WHOLE_HZ, *(rate * 1000 / 1001 for rate in (24, 30, 60, 120)))  # NTSC
_COMMENT = re.compile(r"(?<!\S)//.*|^[ \t]*#.*|#(?!\S).*", re.MULTILINE)
_STATEMENT = re.compile(
    r"(?:(?P<key>root|joint|end(?:site)?)\b(?P<name>[^\n{}]*)(?:\n\s*)?\{|offset(?P<offset>(?:\s+[^\s{}]+){3})"
    r"|channels\s+(?P<count>\d{1,4})(?P<channels>(?:\s+[xyz](?:position|rotation|scale)\b)*)"
    r"|(?P<close>\})|(?P<motion>motion\b))\s*",
    re.IGNORECASE,
)
_HEAD = re.compile(r"\s*frame(?:s|[^\S\n]*(time))[^\S\n]*[:=]?[^\S\n]*(\S*).*", re.IGNORECASE)
_CUT = re.compile(r"(?<!\S)[-+]?(?:\.|\d+\.?\d*[eE][-+]?)?\Z")  # a number that the end of the file cuts off
_GRAMMAR = "OFFSET has three numbers, CHANNELS a count and names such as Xposition, a joint has braces"
_Frames = np.ndarray


@dataclass
class _Joint:
    name: str
    parent: int
    column: int  # of its first channel
    offset: Sequence[float] = (0.0, 0.0, 0.0)
    channels: list[tuple[str, int]] = field(default_factory=list)  # ("position", "rotation" or "scale", axis)
    tip: Sequence[float] | None = None


def read_bvh(path: Path | str, given: JointMap | None = None, *, metres_per_unit: float | None = None) -> Motion:
    """Read a BVH file: in metres, Y up and, at rest, facing +Z. With `metres_per_unit`, its axes stay as they are.

    `given` is the user's own map of its bones.

    Raises:
        MotionError: the file is missing, too large, inconsistent, or contains numbers that are not finite. The message
            names the line and the remedy.
    """
    return _read(Path(path), given, metres_per_unit, is_placed=metres_per_unit is None)[0]


def read_standing(path: Path, given: JointMap | None = None) -> tuple[Motion, Stand]:
    """As `read_bvh`, but where the file has it, and the unit and axes that the figure has there."""
    return _read(path, given)


def _read(
    path: Path, given: JointMap | None, metres_per_unit: float | None = None, *, is_placed: bool = False
) -> tuple[Motion, Stand]:
    with reading(path) as notes:
        text = _text(path, notes)
        with _naming_lines(path, text):
            joints, at = _joints(text)
            frames, fps = _frames(text, at, sum(len(joint.channels) for joint in joints), notes)
        most = min(ROTATIONS, STILL_ROTATIONS + frames.size)
        if len(frames) * len(joints) > most:
            raise MotionError(
                f"{len(frames):,} frames of {len(joints):,} joints are more than {most:,} rotations; cut it"
            )
        joints = _body(joints, notes)
        motion = _assemble(joints, _in_degrees(joints, frames, notes), fps, notes)
        if given is not None:
            motion = replace(motion, skeleton=with_bones(motion.skeleton, given))
        bones = known_bones(motion.skeleton)
        stand = Stand(metres=metres_per_unit) if metres_per_unit else of_clip(motion, bones)
        notes += [] if metres_per_unit else stand.notes()
        motion = righted(motion, stand)
        motion = placed(motion, bones, notes) if is_placed else motion
    return motion, stand


def stated_length(path: Path) -> tuple[int, float]:
    """How many frames a BVH says that it has, and its frame rate. Raises MotionError as `read_bvh`, but for frames."""
    with reading(path) as notes:
        text = _text(path, notes)
        with _naming_lines(path, text):
            stated, fps, at = _head(text, _joints(text)[1], notes)
    return round(stated) if stated > 0 else text[at:].strip().count("\n") + 1, fps


class _TextError(Exception):
    """A fault in a text, `below` lines below the character at index `at`."""

    def __init__(self, complaint: str, at: int | None = None, below: int = 0) -> None:
        super().__init__(complaint)
        self.at, self.below = at, below


@contextmanager
def _naming_lines(path: Path, text: str) -> Iterator[None]:
    """A context in which a `_TextError` becomes a MotionError that names the file and the line."""
    try:
        yield
    except _TextError as error:
        place = "" if error.at is None else f", line {1 + text[: error.at].count(chr(10)) + error.below}"
        raise MotionError(f"{path}{place}: {error}") from None


def _text(path: Path, notes: list[str]) -> str:
    """The text of a file with plain line ends and without comments."""
    with readable(path, MotionError):
        check_file(path, BVH_BYTES, MotionError)
        text, encoding = decoded(path.read_bytes())
    if encoding != "utf-8-sig":
        notes.append(f"its text is taken for {encoding}")
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\0\x1a \t\n")
    if text.count("\n") >= BVH_LINES:
        raise MotionError(f"{path} has more than {BVH_LINES:,} lines; cut it")
    if max(map(len, text.split("\n"))) > BVH_LINE:
        raise MotionError(f"{path} has a line of more than {BVH_LINE:,} letters; it is not a BVH file")
    return _COMMENT.sub("", text)


def _joints(text: str) -> tuple[list[_Joint], int]:
    """The joints of the HIERARCHY block, of one tree or more, and where the block ends."""
    begun = re.match(r"\s*hierarchy\b\s*", text, re.IGNORECASE)
    if not begun:
        raise _TextError("the file does not begin with HIERARCHY; it is not a BVH file", 0)
    found, inside, at, column = list[_Joint](), list[int](), begun.end(), 0  # inside an End Site: -1
    while (said := _STATEMENT.match(text, at)) and said.lastgroup != "motion":
        joint = found[inside[-1]] if inside and inside[-1] >= 0 else None
        match said.lastgroup:
            case "name" if said["key"].lower() in ("root", "joint") and (joint or not inside):
                name = "_".join(said["name"].split()) or f"joint_{len(found)}"
                found.append(_Joint(name, inside[-1] if joint else -1, column))
                inside.append(len(found) - 1)
                if len(found) > JOINTS or len(inside) > DEPTH:
                    raise _TextError(
                        f"more than {JOINTS} joints, or more than {DEPTH} deep; leave out what does not move", at
                    )
            case "name" if joint:
                inside.append(-1)
            case "offset" if joint:
                joint.offset = _triple(said["offset"], at)
            case "offset" if inside:
                found[inside[-2]].tip = _triple(said["offset"], at)
            case "channels" if joint and int(said["count"]) == len(said["channels"].split()) < 10:
                joint.channels = [(word[1:], "xyz".index(word[0])) for word in said["channels"].lower().split()]
                column += len(joint.channels)
            case "close" if inside:
                inside.pop()
            case _:
                break
        at = said.end()
    if not said or said.lastgroup != "motion":
        raise _TextError(
            f"{text[at:][:60].splitlines()[0]!r} is not BVH ({_GRAMMAR}); repair the file"
            if "motion" in text[at:].lower()
            else "the file ends before MOTION; it was cut short, fetch it again",
            at,
        )
    if inside or not found:
        raise _TextError("a closing brace is missing above MOTION, or there is no ROOT; repair the file", at)
    return found, said.end()


def _triple(words: str, at: int) -> list[float]:
    try:
        return [_number(word) for word in words.split()]
    except ValueError:
        raise _TextError("OFFSET needs three finite numbers; repair the file", at) from None


def _number(word: str) -> float:
    """The number in a word; a comma is a decimal point, or follows the number."""
    number = float(word.strip(",").replace(",", "."))
    if not abs(number) < _MOST:
        raise ValueError(word)
    return number


def _head(text: str, at: int, notes: list[str]) -> tuple[float, float, int]:
    """The stated count of frames, 0 for none, the frame rate, and where the table begins."""
    head = {"Frames:": "0", "Frame Time:": "0"}
    while found := _HEAD.match(text, at):
        label, at = "Frame Time:" if found[1] else "Frames:", found.end()
        head[label] = found[2] or "0"
        try:
            _number(head[label])
        except ValueError:
            raise _TextError(
                f"expected {label!r} and a number, not {found[2][:40]!r}; repair the file", found.start(2)
            ) from None
    return _number(head["Frames:"]), _rate(head["Frame Time:"], at, notes), at


def _frames(text: str, at: int, width: int, notes: list[str]) -> tuple[_Frames, float]:
    """The table of channel values, one row per frame, and the frame rate."""
    stated, fps, at = _head(text, at, notes)
    if not width or not (stated or text[at:].strip()):
        notes.append(f"it has no {'frames' if width else 'channels'}, and its rest pose is read")
        return np.zeros((1, width)), fps
    cut = _CUT.search(text[at:][-64:])
    table = text[at : len(text) - len(cut[0] if cut else "")]
    if "," in table:
        table = table.replace(",", " ") if "." in table else re.sub(r",(?=\s|\Z)", " ", table).replace(",", ".")
    lines, read, sizes = table.split("\n"), array("d"), [0]
    with suppress(ValueError):
        for words in map(str.split, lines):
            read.extend(map(float, words))
            sizes.append(len(words))
    flat, ends = np.asarray(read), np.cumsum(sizes)
    is_number = np.append(np.abs(flat) < _MOST, len(ends) > len(lines))
    if not is_number.all():
        line = int(np.searchsorted(ends, bad := int(np.argmin(is_number)), "right")) - 1
        word = lines[line].split()[bad - ends[line]]
        raise _TextError(f"{word[:40]!r} is not a finite number below {_MOST:g}; repair the file", at, line)
    is_line = np.diff(ends) > 0
    starts, ends = ends[:-1][is_line], ends[1:][is_line]
    # a line that begins within a frame and ends in another
    is_apart = (starts % width > 0) & (starts // width != (ends - 1) // width)
    if flat.size != stated * width and is_apart.any():
        if min(ends - starts) < width:
            line = next(k for k, size in enumerate(sizes[1:]) if size not in (0, width))
            complaint = f"{sizes[line + 1]} values, but the hierarchy has {width} channels; the file is damaged"
            raise _TextError(f"{complaint}, fetch it again", at, line)
        flat = flat[starts[:, None] + np.arange(width)].ravel()
        notes.append(f"its lines have up to {max(sizes)} values, and the first {width} are read")
    count, rest = divmod(flat.size, width)
    if count < 1:
        raise _TextError("the file has no frames; choose another")
    if rest:
        notes.append(f"it ends within frame {count + 1}, and the {count} before are read")
    elif count != stated:
        notes.append(f"it says {stated:.12g} frames, and the {count} that it has are read")
    return flat[: count * width].reshape(count, width), fps


def _rate(word: str, at: int, notes: list[str]) -> float:
    """Frames per second. Most files round the seconds between frames: 0.0333667 means 30000/1001."""
    seconds = _number(word)
    if seconds == 0:
        notes.append(f"it has no frame time, and {_ASSUMED_HZ:g} frames per second are assumed")
        return _ASSUMED_HZ
    if not 1e-4 < seconds <= _LONGEST_S:
        raise _TextError(
            f"Frame Time {seconds:g} is not 0.0001 to {_LONGEST_S:g}; write the seconds between frames", at
        )
    halves, step = 2 / seconds, 10.0 ** int(Decimal(word.strip(",").replace(",", ".")).normalize().as_tuple().exponent)
    if abs(halves - round(halves)) < 1e-7:
        return round(halves) / 2
    for rate in _RATES_HZ:
        if -0.501 * step < 1 / rate - seconds < 0.7 * step < 0.1 * seconds:
            return float(rate)
    return usual_rate(1 / seconds)


def _body(joints: list[_Joint], notes: list[str]) -> list[_Joint]:
    """The tree with the most known bones, with unique names."""
    roots = [j for j, joint in enumerate(joints) if joint.parent < 0]
    trees = [joints[root:stop] for root, stop in zip(roots, [*roots[1:], len(joints)], strict=True)]
    for root, tree in zip(roots, trees, strict=True):
        names = numbered(joint.name for joint in tree)
        if names != [joint.name for joint in tree]:
            notes.append("joints of the same name are numbered")
        for joint, name in zip(tree, names, strict=True):
            joint.name, joint.parent = name, max(joint.parent - root, -1)
    if len(trees) == 1:
        return trees[0]
    best = max(trees, key=lambda tree: (len(known_bones(_skeleton(tree))), len(tree)))
    notes.append(f"it has {len(trees)} skeletons, and that of {best[0].name!r} is read")
    return best


def _assemble(joints: list[_Joint], frames: _Frames, fps: float, notes: list[str]) -> Motion:
    """The motion in the file's own unit and axes."""
    rotations = np.empty((len(frames), len(joints), 4), np.float32)
    places: list[_Frames] = []  # from the parent: (t, 3) of joints with position channels, (1, 3) of the others
    is_beside = False
    for j, joint in enumerate(joints):
        rotation = np.tile([1.0, 0.0, 0.0, 0.0], (len(frames), 1))
        moved = [axis for kind, axis in joint.channels if kind == "position"]
        place = np.tile(joint.offset, (len(frames) if moved or j == 0 else 1, 1))
        for column, (kind, axis) in enumerate(joint.channels, joint.column):
            if kind == "position":
                place[:, axis] = frames[:, column]
            elif kind == "rotation":
                rotation = _rotated(rotation, frames[:, column], axis)
        offset = np.array(joint.offset)[moved]
        if j and np.linalg.norm(place[:, moved].mean(0)) < _BESIDE * np.linalg.norm(offset):
            place[:, moved] += offset
            is_beside = True
        rotations[:, j] = rotation
        places.append(place)
    if is_beside:
        notes.append("positions of joints are added to their OFFSET")
    if any(kind == "scale" for joint in joints for kind, _ in joint.channels):
        notes.append("scale channels are left out")
    longest = max((float(np.linalg.norm(place.mean(0))) for place in places[1:]), default=0.0) or 1.0
    while body := _body_below(joints, [float(np.ptp(place, axis=0).max()) > _RIGID * longest for place in places]):
        if len(body) < len(joints) - 1:
            notes.append(f"joints beside {joints[body[0]].name!r} are left out")
        joints, rotations, places = _merge_root(joints, rotations, places, body)
    stretch = max((float(np.ptp(place, axis=0).max()) for place in places[1:]), default=0.0)
    if stretch > _RIGID * longest:
        share = 100 * stretch / longest
        notes.append(f"bones change their length by up to {share:.1f}% of the longest, and their mean length is used")
    for joint, place in zip(joints[1:], places[1:], strict=True):
        joint.offset = place.mean(0).tolist()
    return Motion(_skeleton(joints), np.ascontiguousarray(rotations), places[0].astype(np.float32), fps)


def _in_degrees(joints: list[_Joint], frames: _Frames, notes: list[str]) -> _Frames:
    """The frames in degrees. Radians are assumed if the body stands in radians, and hardly leaves T-pose in degrees."""
    turns = [joint.column + k for joint in joints for k, (kind, _) in enumerate(joint.channels) if kind == "rotation"]
    angles = frames[:, turns]
    if not 1 < np.abs(angles).max(initial=0) <= 2 * np.pi + 1e-5:
        return frames
    turned = frames.copy()
    turned[:, turns] = np.degrees(angles)
    motion = _assemble([replace(joint) for joint in joints], turned, _ASSUMED_HZ, [])
    bones, poses = known_bones(motion.skeleton), np.stack([motion.skeleton.rest_positions, *motion.pose().positions])
    if all(bone in bones for way in (*_ARMS, *_STANDING) for bone in way) and np.ptp(angles, axis=0).max() > _MOVING:
        arms, stands = ([unit(poses[:, bones[b]] - poses[:, bones[a]]) for a, b in ways] for ways in (_ARMS, _STANDING))
        hanging = min(-(way[1:] @ stands[0][0]).mean() for way in arms[1:])  # no arm of a T-pose that sways
        if min(arms[0][0] @ arms[1][0], hanging, *((way[1:] @ way[0]).mean() for way in stands)) > _ALONG:
            notes.append("its angles are taken for radians")
            return turned
    notes.append("no angle is above 6.28 degrees; if they are radians, write degrees")
    return frames


def _skeleton(joints: list[_Joint]) -> Skeleton:
    return Skeleton(
        SkeletonConfig(
            names=tuple(joint.name for joint in joints),
            parents=tuple(joint.parent for joint in joints),
            offsets=triples(joint.offset for joint in joints),
            tips={joint.name: triples([joint.tip])[0] for joint in joints if joint.tip is not None},
        )
    )


def _rotated(quaternion: _Frames, degrees: _Frames, axis: int) -> _Frames:
    half = np.radians(degrees) / 2
    step = np.zeros((len(half), 4))
    step[:, 0], step[:, 1 + axis] = np.cos(half), np.sin(half)
    return quaternion_multiply(quaternion, step)


def _body_below(joints: list[_Joint], travels: list[bool]) -> range:
    """The subtree of a travelling child of the root that holds the whole body; empty if there is none."""
    children = [j for j, joint in enumerate(joints) if joint.parent == 0]
    if not any(travels[child] for child in children):
        return range(0)
    bones = known_bones(_skeleton(joints))
    wanted = set(bones.values()) if "hips" in bones else set(range(1, len(joints)))
    parts = [range(start, stop) for start, stop in pairwise([*children, len(joints)])]
    return next((part for part in parts if travels[part[0]] and wanted <= set(part)), range(0))


def _merge_root(
    joints: list[_Joint], rotations: NDArray[np.float32], places: list[_Frames], body: range
) -> tuple[list[_Joint], NDArray[np.float32], list[_Frames]]:
    """Remove the root and all beside the subtree `body`, whose first joint takes over the root's movement."""
    start, *others = body
    root, child = (rotations[:, j].astype(np.float64) for j in (0, start))
    moved = (matrix_from_quaternion(root) @ places[start][..., None])[..., 0] + places[0]
    rotations = rotations[:, start : body.stop]
    rotations[:, 0] = quaternion_multiply(root, child)
    offset = np.add(joints[0].offset, joints[start].offset).tolist()
    kept = [replace(joints[j], parent=joints[j].parent - start) for j in others]
    return ([replace(joints[start], parent=-1, offset=offset), *kept], rotations, [moved, *(places[j] for j in others)])
