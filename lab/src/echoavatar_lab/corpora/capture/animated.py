"""Motion that animators keyed for other bodies: MikuMikuDance's VMD, and qianim, the gestures of the robot Pepper.

Both give a standing body on our rig: arms, head and, from VMD, trunk and fingers. Legs are left out, because VMD moves
them by IK targets that need the character's model, and Pepper has none. Faces are left out too. Not in the paper.
"""

import struct
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.limits import CONFIG_BYTES, STILL_ROTATIONS, read_bytes
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, slerp
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.controls import STANDING_PELVIS, Array
from echoavatar_lab.corpora.solver import about
from echoavatar_lab.kinematics import quaternion_from_matrix

A_POSE = np.deg2rad(37.0)  # by which a MikuMikuDance character's arms hang when no bone is turned
SUFFIXES = (".vmd", ".qianim")
_VMD_HEAD, _VMD_KEY = 54, 111  # bytes
_VMD_RATE_HZ = 30.0
_ROTATION_CURVE = (48, 56, 52, 60)  # of x1, x2, y1, y2 among a key's 64 bytes of curves
_TRUNK = {"上半身": "spine", "上半身2": "chest", "首": "neck", "頭": "head"}
_ARM = {"肩": "Shoulder", "腕": "UpperArm", "腕捩": "UpperArm", "ひじ": "LowerArm", "手捩": "Hand", "手首": "Hand"}
_FINGERS = {"人指": "Index", "中指": "Middle", "薬指": "Ring", "小指": "Little"}
_DIGITS = {"１": "Proximal", "２": "Intermediate", "３": "Distal"}
_THUMB = {"親指０": "ThumbMetacarpal", "親指１": "ThumbProximal", "親指２": "ThumbDistal"}
_CLOSED = 0.9  # radians of each finger joint
Keys = list[tuple[float, Float[np.ndarray, " 4"], tuple[float, float, float, float]]]


@np.errstate(invalid="ignore", over="ignore")  # `Motion` looks for what is not finite
def read_animated(path: Path) -> Motion:
    """A body on our rig at 30 fps from a file with one of `SUFFIXES`.

    Raises MotionError if the file is missing, too large or damaged, or moves no bone that we know.
    """
    try:
        turns = (_vmd if path.suffix == ".vmd" else _qianim)(read_bytes(path, CONFIG_BYTES, MotionError))
    except (OSError, ArithmeticError, ValueError, TypeError, IndexError, struct.error, ElementTree.ParseError) as error:
        raise MotionError(f"{path} cannot be read as {path.suffix} ({str(error)[:80]})") from error
    if not turns:
        raise MotionError(f"{path} moves no bone that we know")
    frames = max(len(turn) for turn in turns.values())
    local = torch.eye(3, dtype=torch.float64).repeat(frames, HUMANOID.joints, 1, 1)
    for name, turn in turns.items():
        local[:, HUMANOID.index(name)] = turn
    root = np.broadcast_to(np.array(STANDING_PELVIS, np.float32), (frames, 3)).copy()
    return Motion(HUMANOID, quaternion_from_matrix(local).float().numpy(), root, float(FRAME_RATE_HZ))


def _vmd(data: bytes) -> dict[str, Float[Tensor, "t 3 3"]]:
    """Turns of our bones. VMD's axes are left-handed, parallel to the world's in each bone, and its body faces -Z."""
    if not data.startswith(b"Vocaloid Motion Data"):
        raise ValueError("no VMD header")
    keys: dict[str, Keys] = defaultdict(list)
    for number in range(struct.unpack_from("<I", data, _VMD_HEAD - 4)[0]):
        at = _VMD_HEAD + number * _VMD_KEY
        name = data[at : at + 15].split(b"\0")[0].decode("shift_jis", "replace")
        frame, _, _, _, x, y, z, w = struct.unpack_from("<I7f", data, at + 15)
        x1, x2, y1, y2 = (data[at + 47 + byte] / 127 for byte in _ROTATION_CURVE)
        keys[name].append((frame / _VMD_RATE_HZ, np.array([w, -x, -y, z]), (x1, x2, y1, y2)))
    last = max((key[0] for found in keys.values() for key in found), default=0.0)
    frames = _frames(last)
    turns: dict[str, Tensor] = {}
    for name, bone in _vmd_bones().items():
        if name in keys:
            turn = torch.from_numpy(_between(sorted(keys[name], key=lambda key: key[0]), frames))
            turns[bone] = turns[bone] @ turn if bone in turns else turn
    if not turns:
        return {}
    for side, down in (("left", -A_POSE), ("right", A_POSE)):
        hang = about("z", torch.tensor(down).double())
        upper = turns.pop(f"{side}UpperArm", torch.eye(3, dtype=torch.float64))
        for bone, turn in turns.items():
            if bone.startswith(side) and not bone.endswith("Shoulder"):
                turns[bone] = hang.mT @ turn @ hang
        turns[f"{side}UpperArm"] = (upper @ hang).expand(frames, 3, 3)
    return turns


def _vmd_bones() -> dict[str, str]:
    """Our bone for each of VMD's, in the order in which turns of one bone are multiplied."""
    bones = dict(_TRUNK)
    for name, side in (("左", "left"), ("右", "right")):
        bones |= {name + bone: side + ours for bone, ours in (_ARM | _THUMB).items()}
        bones |= {name + f + d: side + finger + part for f, finger in _FINGERS.items() for d, part in _DIGITS.items()}
    return bones


def _between(keys: Keys, frames: int) -> Float[Array, "t 3 3"]:
    """Rotations at the frame rate; a key's curve belongs to the way to it."""
    times, rotations = np.array([key[0] for key in keys]), np.stack([key[1] for key in keys])
    before, after, _, phase = _ways(times, np.arange(frames) / FRAME_RATE_HZ)
    x1, x2, y1, y2 = np.array([key[2] for key in keys])[after].T
    share = _bezier(_parameter(phase, x1, x2), y1, y2)
    return matrix_from_quaternion(slerp(rotations[before], rotations[after], share))


def _ways(times: Array, clock: Array) -> tuple[Array, Array, Array, Array]:
    """For each time, the keys before and after it, the time between them, and the share of that time gone by."""
    after = np.clip(np.searchsorted(times, clock, side="right"), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    way = np.maximum(times[after] - times[before], 1e-9)
    return before, after, way, np.clip((clock - times[before]) / way, 0, 1)


def _bezier(t: Array, first: Array, second: Array) -> Array:
    """A cubic Bezier curve from 0 to 1 with these handles."""
    return np.asarray(3 * (1 - t) ** 2 * t * first + 3 * (1 - t) * t**2 * second + t**3)


def _frames(last_s: float) -> int:
    """Frames up to the last key."""
    frames = round(last_s * FRAME_RATE_HZ) + 1
    if not 0 < frames * HUMANOID.joints <= STILL_ROTATIONS:  # a single key may say that it is years away
        raise ValueError(f"the last key is at {last_s:.0f} s")
    return frames


def _parameter(x: Array, x1: Array, x2: Array) -> Array:
    """Where a Bezier curve from x = 0 to 1 with these handles has the wanted x; found by halving."""
    low, high = np.zeros_like(x), np.ones_like(x)
    for _ in range(30):
        t = (low + high) / 2
        is_short = _bezier(t, x1, x2) < x
        low, high = np.where(is_short, t, low), np.where(is_short, high, t)
    return np.asarray((low + high) / 2)


def _qianim(data: bytes) -> dict[str, Float[Tensor, "t 3 3"]]:
    """Turns of our bones from Pepper's joints, whose arms point ahead, palms down, where all angles are 0."""
    curves = {
        curve.get("actuator", ""): curve
        for curve in ElementTree.fromstring(data)
        if curve.tag.endswith("ActuatorCurve") and len(curve)
    }
    times = [float(key.get("frame", 0)) / float(c.get("fps", 25)) for c in curves.values() for key in c]
    if not times:
        return {}
    frames = _frames(max(times))

    def turn(axes: str, *joints: str) -> Tensor:
        """Pepper's left, up and forward axes are our x, y and z."""
        made = torch.eye(3, dtype=torch.float64)
        for axis, joint in zip(axes, joints, strict=True):
            made = made @ about(axis, torch.from_numpy(np.deg2rad(_curve(curves.get(joint), frames))))
        return made

    turns = {"head": turn("yx", "HeadYaw", "HeadPitch")}
    for letter, side, ahead in (("L", "left", -np.pi / 2), ("R", "right", np.pi / 2)):
        rest = about("y", torch.tensor(ahead).double())
        turns[f"{side}UpperArm"] = turn("xy", f"{letter}ShoulderPitch", f"{letter}ShoulderRoll") @ rest
        turns[f"{side}LowerArm"] = rest.mT @ turn("zy", f"{letter}ElbowYaw", f"{letter}ElbowRoll") @ rest
        turns[f"{side}Hand"] = rest.mT @ turn("z", f"{letter}WristYaw") @ rest
        opened = _curve(curves.get(f"{letter}Hand"), frames)
        bend = _CLOSED * (1 - np.clip(opened, 0, 1)) * (-1 if side == "left" else 1)
        bones = [f"{side}{finger}{part}" for finger in _FINGERS.values() for part in _DIGITS.values()]
        turns |= dict.fromkeys(bones, about("z", torch.from_numpy(bend)))
    return turns


def _curve(curve: ElementTree.Element | None, frames: int) -> Float[np.ndarray, " t"]:
    """Values at the frame rate of a curve of Bezier keys; 0 without keys."""
    if curve is None:
        return np.zeros(frames)
    rate = float(curve.get("fps", 25))
    at, value = (np.array([float(key.get(name, 0)) for key in curve]) for name in ("frame", "value"))
    right, left = (np.array([_tangent(key, side) for key in curve]) for side in ("right", "left"))
    before, after, way, phase = _ways(at, np.arange(frames) / FRAME_RATE_HZ * rate)
    t = _parameter(phase, right[before, 0] / way, 1 + left[after, 0] / way)
    first, second = value[before] + right[before, 1], value[after] + left[after, 1]
    ends = (1 - t) ** 3 * value[before] + t**3 * value[after]
    return np.asarray(ends + 3 * (1 - t) ** 2 * t * first + 3 * (1 - t) * t**2 * second)


def _tangent(key: ElementTree.Element, side: str) -> tuple[float, float]:
    found = next((one for one in key if one.get("side") == side), None)
    return (0.0, 0.0) if found is None else (float(found.get("abscissaParam", 0)), float(found.get("ordinateParam", 0)))
