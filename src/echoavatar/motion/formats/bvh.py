"""Read and write BVH, the common format of captured motion: any hierarchy, any channel order.

Joints below the root may have position channels. If the root's only child travels (as in the Bandai-Namco data), the
root is merged into it. Elsewhere bones count as rigid, and their mean length is used.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ValidationError

from echoavatar.errors import MotionError
from echoavatar.limits import BVH_BYTES, BVH_LINE, BVH_LINES, DEPTH, JOINTS, ROTATIONS, STILL_ROTATIONS, check_file
from echoavatar.whole_file import write_whole

from ..kinematics.motion import Motion
from ..kinematics.rotations import euler_from_matrix, matrix_from_quaternion, quaternion_multiply
from ..kinematics.skeleton import Skeleton, SkeletonConfig

_log = logging.getLogger(__name__)
_RIGID_M = 1e-3  # a bone that changes its length by more is reported
_CHANNELS = {f"{axis}{kind}": (kind, i) for i, axis in enumerate("XYZ") for kind in ("position", "rotation")}
_Frames = np.ndarray


@dataclass
class _Joint:
    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: list[tuple[str, int]] = field(default_factory=list)  # ("position" or "rotation", axis)
    tip: tuple[float, float, float] | None = None


def read_bvh(path: Path | str, *, metres_per_unit: float = 0.01) -> Motion:
    """Read a BVH file, in centimetres by default.

    Raises:
        MotionError: the file is missing, too large, cut short, inconsistent, or contains numbers that are not finite.
            The message names the line and the remedy.
    """
    path = Path(path)
    try:
        check_file(path, BVH_BYTES, MotionError)
        lines = _lines(path, path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise MotionError(f"{path} does not exist; check the name") from error
    except (OSError, UnicodeDecodeError) as error:
        raise MotionError(f"{path} cannot be read as text; it is not a BVH file") from error
    reader = _Header(path, lines)
    joints = reader.joints()
    frames, fps = _numbers(path, lines, reader.line, sum(len(joint.channels) for joint in joints))
    most = min(ROTATIONS, STILL_ROTATIONS + frames.size)
    if len(frames) * len(joints) > most:
        raise MotionError(
            f"{path}: {len(frames):,} frames of {len(joints):,} joints are more than {most:,} rotations; cut it"
        )
    try:
        return _assemble(joints, frames, fps, metres_per_unit)
    except ValidationError as error:
        raise MotionError(f"{path}: {error.errors()[0]['msg']}; repair the file") from error


def write_bvh(
    path: Path | str,
    skeleton: Skeleton,
    rotations: NDArray[np.float32],
    root: NDArray[np.float32],
    fps: float,
    *,
    scale: float = 100.0,
    order: str = "zyx",
) -> None:
    """Write a BVH file, completely or not at all. Euler angles continue past 180 degrees instead of jumping.

    Args:
        path: where to write.
        skeleton: the rig; its tips become End Sites.
        rotations: (t, j, 4) parent-relative quaternions `wxyz`.
        root: (t, 3) world position of the root, metres.
        fps: frames per second.
        scale: units per metre, 100 for centimetres.
        order: order of the rotation channels.
    """
    motion = Motion(skeleton, np.asarray(rotations, np.float32), np.asarray(root, np.float32), fps)
    angles = np.degrees(_continuous_euler(motion.rotations, order))[:, _depth_first(skeleton)]
    angles = angles.reshape(motion.frames, -1)
    table = np.concatenate([motion.root.astype(np.float64) * scale, angles], 1)
    row = " ".join(["%.6f"] * table.shape[1])
    lines = ["HIERARCHY", *_hierarchy(skeleton, scale, order), "MOTION", f"Frames: {motion.frames}"]
    lines += [f"Frame Time: {1 / fps:.9f}", *(row % tuple(frame) for frame in table.tolist())]
    write_whole(path, "\n".join(lines) + "\n", error=MotionError)


_ENDS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"  # where `splitlines` splits


def _lines(path: Path, text: str) -> list[str]:
    """The lines of a file; each one is an object, and so is each word of the line that is read."""
    if sum(map(text.count, _ENDS)) > BVH_LINES:
        raise MotionError(f"{path} has more than {BVH_LINES:,} lines; cut it")
    lines = text.splitlines()
    if max(map(len, lines), default=0) > BVH_LINE:
        raise MotionError(f"{path} has a line of more than {BVH_LINE:,} letters; it is not a BVH file")
    return lines


class _Header:
    """Reads the HIERARCHY block; `line` is the current line, counted from 0."""

    def __init__(self, path: Path, lines: Sequence[str]) -> None:
        self.path, self.lines, self.line = path, lines, 0
        self._names: set[str] = set()

    def joints(self) -> list[_Joint]:
        found: list[_Joint] = []
        open_joints: list[int] = []  # -1 stands for an End Site
        self.line = next((i for i, text in enumerate(self.lines) if text.strip()), 0)
        if not self.lines or self.lines[self.line].strip() != "HIERARCHY":
            self.fail("the file does not begin with HIERARCHY; it is not a BVH file")
        while self.line + 1 < len(self.lines):
            self.line += 1
            words = self.lines[self.line].split()
            if not words or words == ["{"]:
                continue
            if words[0] == "MOTION":
                break
            self._statement(words, found, open_joints)
        else:
            self.fail("the file ends before MOTION; it was cut short, fetch it again")
        if open_joints:
            self.fail("a closing brace is missing above MOTION; repair the file")
        if not found:
            self.fail("there is no ROOT; it is not a BVH file")
        return found

    def _statement(self, words: list[str], found: list[_Joint], open_joints: list[int]) -> None:
        if words[0] in ("ROOT", "JOINT") and len(words) >= 2:
            if words[0] == "ROOT" and found:
                self.fail("a second ROOT; keep one skeleton per file")
            name = "_".join(words[1:])
            if name in self._names:
                self.fail(f"joint {name!r} occurs twice; rename one")
            if len(found) >= JOINTS or len(open_joints) >= DEPTH:
                self.fail(f"more than {JOINTS} joints, or more than {DEPTH} deep; leave out what does not move")
            self._names.add(name)
            found.append(_Joint(name, open_joints[-1] if open_joints else -1))
            open_joints.append(len(found) - 1)
        elif words[0] == "End":
            open_joints.append(-1)
        elif words[0] == "OFFSET" and open_joints:
            offset = self._triple(words[1:])
            if open_joints[-1] >= 0:
                found[open_joints[-1]].offset = offset
            elif len(open_joints) > 1:
                found[open_joints[-2]].tip = offset
        elif words[0] == "CHANNELS" and open_joints and open_joints[-1] >= 0:
            found[open_joints[-1]].channels = self._channels(words[1:])
        elif words[0] == "}" and open_joints:
            open_joints.pop()
        else:
            self.fail(f"{' '.join(words[:4])!r} is not BVH; repair the file")

    def _triple(self, words: list[str]) -> tuple[float, float, float]:
        try:
            x, y, z = (float(word) for word in words)
        except ValueError:
            self.fail("OFFSET needs three numbers; repair the file")
        if not np.isfinite([x, y, z]).all():
            self.fail("OFFSET is not finite; repair the file")
        return x, y, z

    def _channels(self, words: list[str]) -> list[tuple[str, int]]:
        if not words or not words[0].isdigit() or int(words[0]) != len(words) - 1:
            self.fail("CHANNELS needs their number and as many names; repair the file")
        if any(word not in _CHANNELS for word in words[1:]):
            self.fail(f"channels are named {', '.join(_CHANNELS)}; repair the file")
        if len(words) > 1 + len(_CHANNELS):
            self.fail(f"a joint has at most {len(_CHANNELS)} channels; repair the file")
        return [_CHANNELS[word] for word in words[1:]]

    def fail(self, complaint: str) -> NoReturn:
        raise MotionError(f"{self.path}, line {self.line + 1}: {complaint}")


def _numbers(path: Path, lines: Sequence[str], motion_line: int, width: int) -> tuple[_Frames, float]:
    """The table of channel values, one row per frame, and the frame rate."""
    fields = [i for i in range(motion_line + 1, len(lines)) if lines[i].strip()]
    head: dict[str, float] = {}
    for label in ("Frames:", "Frame Time:"):
        at = fields.pop(0) if fields else len(lines) - 1
        text = lines[at]
        try:
            head[label] = float(text.strip().removeprefix(label))
        except ValueError:
            raise MotionError(f"{path}, line {at + 1}: expected {label!r} and a number") from None
    if not float(head["Frames:"]).is_integer():
        raise MotionError(f"{path}: Frames {head['Frames:']} is not a whole number; write how many there are")
    count, frame_time = int(head["Frames:"]), head["Frame Time:"]
    if not 1e-6 < frame_time < 1e6:
        raise MotionError(
            f"{path}: Frame Time {frame_time} is not above 0 and below a million; write the seconds between frames"
        )
    if count < 1:
        raise MotionError(f"{path}: the file has no frames; choose another")
    try:
        flat = np.fromiter((float(word) for at in fields for word in lines[at].split()), np.float64)
    except ValueError:
        flat = np.empty(0)
    if flat.size != count * width or not np.isfinite(flat).all():
        _explain(path, lines, fields, count, width)
    fps = 1 / frame_time
    return flat.reshape(count, width), float(round(fps)) if abs(fps - round(fps)) < 2e-3 * fps else fps


def _explain(path: Path, lines: Sequence[str], fields: list[int], count: int, width: int) -> NoReturn:
    """Raise the error that names the wrong line. This is slow, and runs only when a line is wrong."""
    for at in fields:
        words = lines[at].split()
        for word in words:
            try:
                is_finite = bool(np.isfinite(float(word)))
            except ValueError:
                is_finite = False
            if not is_finite:
                raise MotionError(f"{path}, line {at + 1}: {word!r} is not a finite number; repair the file")
        if len(words) != width:
            raise MotionError(
                f"{path}, line {at + 1}: {len(words)} values, but the hierarchy has {width} channels;"
                " the file was cut short or damaged, fetch it again"
            )
    raise MotionError(
        f"{path}: {len(fields)} frames, but the header says {count}; cut short? fetch it again or correct 'Frames:'"
    )


def _assemble(joints: list[_Joint], frames: _Frames, fps: float, unit: float) -> Motion:
    rotations = np.empty((len(frames), len(joints), 4), np.float32)
    places: list[_Frames] = []  # (t, 3) of each joint that moves along, (1, 3) of the others
    column = 0
    for j, joint in enumerate(joints):
        rotation = np.tile([1.0, 0.0, 0.0, 0.0], (len(frames), 1))
        is_moving = any(kind == "position" for kind, _ in joint.channels)
        place = np.tile(joint.offset, (len(frames) if is_moving or j == 0 else 1, 1))
        for kind, axis in joint.channels:
            if kind == "position":
                place[:, axis] = frames[:, column]
            else:
                rotation = _rotated(rotation, frames[:, column], axis)
            column += 1
        rotations[:, j] = rotation
        places.append(place * unit)
    while len(joints) > 1 and _has_travelling_child(joints, places):
        joints, rotations, places = _merge_root(joints, rotations, places)
    stretch = max((float(np.ptp(place, axis=0).max()) for place in places[1:]), default=0.0)
    if stretch > _RIGID_M:
        _log.warning("bones change their length by up to %.1f mm; their mean length is used", stretch * 1000)
    offsets = np.array([np.multiply(joints[0].offset, unit), *(place.mean(0) for place in places[1:])])
    skeleton = Skeleton(
        SkeletonConfig(
            names=tuple(joint.name for joint in joints),
            parents=tuple(joint.parent for joint in joints),
            offsets=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
            tips={j.name: _scaled(j.tip, unit) for j in joints if j.tip is not None},
        )
    )
    return Motion(skeleton, np.ascontiguousarray(rotations), places[0].astype(np.float32), fps)


def _scaled(offset: tuple[float, float, float], unit: float) -> tuple[float, float, float]:
    return offset[0] * unit, offset[1] * unit, offset[2] * unit


def _rotated(quaternion: _Frames, degrees: _Frames, axis: int) -> _Frames:
    half = np.radians(degrees) / 2
    step = np.zeros((len(half), 4))
    step[:, 0], step[:, 1 + axis] = np.cos(half), np.sin(half)
    product: _Frames = quaternion_multiply(torch.from_numpy(quaternion.copy()), torch.from_numpy(step)).numpy()
    return product


def _has_travelling_child(joints: list[_Joint], places: list[_Frames]) -> bool:
    only_child = [j for j, joint in enumerate(joints) if joint.parent == 0] == [1]
    return only_child and float(np.ptp(places[1], axis=0).max()) > _RIGID_M


def _merge_root(
    joints: list[_Joint], rotations: NDArray[np.float32], places: list[_Frames]
) -> tuple[list[_Joint], NDArray[np.float32], list[_Frames]]:
    """Remove the root; its only child takes over its movement and becomes the root."""
    root, child = (torch.from_numpy(rotations[:, j].astype(np.float64)) for j in (0, 1))
    moved = (matrix_from_quaternion(root) @ torch.from_numpy(places[1])[..., None]).squeeze(-1).numpy() + places[0]
    rotations = rotations[:, 1:]
    rotations[:, 0] = quaternion_multiply(root, child).numpy()
    first, second = joints[0], joints[1]
    x, y, z = np.add(first.offset, second.offset).tolist()
    kept = [_Joint(second.name, -1, (x, y, z), second.channels, second.tip)]
    kept += [_Joint(j.name, j.parent - 1, j.offset, j.channels, j.tip) for j in joints[2:]]
    return kept, rotations, [moved, *places[2:]]


def _continuous_euler(rotations: NDArray[np.float32], order: str) -> _Frames:
    """Angles (t, j, 3) in radians. Of the two triples for a rotation, the one nearer to the last frame's is taken."""
    matrices = matrix_from_quaternion(torch.from_numpy(rotations.astype(np.float64)))
    plain: _Frames = euler_from_matrix(matrices, order).numpy()
    other = plain * [1, -1, 1] + np.pi
    angles = plain.copy()
    for t in range(1, len(angles)):
        last = angles[t - 1]
        near = plain[t] + 2 * np.pi * np.round((last - plain[t]) / (2 * np.pi))
        far = other[t] + 2 * np.pi * np.round((last - other[t]) / (2 * np.pi))
        is_far = np.abs(far - last).sum(-1) < np.abs(near - last).sum(-1)
        angles[t] = np.where(is_far[:, None], far, near)
    return angles


def _depth_first(skeleton: Skeleton) -> list[int]:
    """Joints in the order in which the file lists them."""
    order, waiting = [], [0]
    while waiting:
        order.append(waiting.pop())
        waiting += [j for j in reversed(range(skeleton.joints)) if skeleton.parents[j] == order[-1]]
    return order


def _hierarchy(skeleton: Skeleton, scale: float, order: str) -> list[str]:
    axes = " ".join(f"{axis.upper()}rotation" for axis in order)
    offsets = skeleton.offsets.double().numpy() * scale
    tips = skeleton.config.tips
    lines: list[str] = []

    def put(joint: int, depth: int) -> None:
        pad, inner = "\t" * depth, "\t" * (depth + 1)
        name = skeleton.names[joint]
        lines.append(f"{pad}{'ROOT' if depth == 0 else 'JOINT'} {name}")
        lines.extend([f"{pad}{{", f"{inner}OFFSET {_words(offsets[joint])}"])
        travel = "6 Xposition Yposition Zposition" if depth == 0 else "3"
        lines.append(f"{inner}CHANNELS {travel} {axes}")
        below = [j for j in range(skeleton.joints) if skeleton.parents[j] == joint]
        for child in below:
            put(child, depth + 1)
        if not below or name in tips:
            tip = np.multiply(tips.get(name, (0.0, 0.0, 0.0)), scale)
            lines.extend([f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {_words(tip)}", f"{inner}}}"])
        lines.append(f"{pad}}}")

    put(0, 0)
    return lines


def _words(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
