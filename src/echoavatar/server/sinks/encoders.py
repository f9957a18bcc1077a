"""Frames as datagrams of other programs' protocols.

- VMC, the protocol of VTuber programs (VSeeFace, Warudo, Unity, Unreal, Blender): bones and expressions over OSC. We
  are the performer; the program with the avatar listens, by default on port 39539. Positions and rotations are in
  Unity's left-handed axes. Bones have Unity's names, which place thumb names one bone further out than VRM 1.0 does.
  Building 110 messages sixty times a second would cost milliseconds, so the bytes are built once (`Bundles`), and each
  frame only writes its numbers into them.
- Live Link Face, the protocol of Epic's iPhone app: one face per packet, for MetaHumans, without a plugin. No body. The
  packet orders the 52 shapes as Apple's headers and Unreal do, left before right. (The CSV that the same app writes has
  the right side of jaw and mouth first.) Angles have the signs of that CSV: to the avatar's left and up is negative.
- JSON over UDP, the simplest format to write a receiver for. Each frame is one datagram, `{"type": "pose", ...}`. Once
  a second `{"type": "rig", ...}` names the joints and curves. Axes are ours: metres, Y up, facing +Z, left +X;
  quaternions are x y z w, relative to the parent.
"""

import struct
import uuid
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, get_args

import msgspec
import numpy as np
from jaxtyping import Float

from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES, HEAD_AND_EYES, VRM_NAMES, reorder, to_live_link, to_vrm
from echoavatar.motion.kinematics.rotations import euler_from_matrix, matrix_from_quaternion
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import Rig

RIG_SECONDS = 1.0
_DIGITS = 5
VERSION = 6
SHAPES = 61
_HEAD = slice(len(ARKIT_NAMES), len(ARKIT_NAMES) + 3)
LARGEST = 1400  # bytes of a datagram; fits an Ethernet frame with its headers
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)  # time tag: immediately
Names = Literal["vrm0", "vrm1", "arkit", "perfect"]
NAMES = get_args(Names)
_VRM0 = (
    "A", "I", "U", "E", "O", "Blink", "Blink_L", "Blink_R", "LookUp", "LookDown", "LookLeft", "LookRight",
)  # fmt: skip
_THUMBS = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}
_ROOT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Frame(NamedTuple):
    """What is shown at one moment, in our axes (Y up, facing +Z, left +X)."""

    rotations: Float[np.ndarray, "j 4"]  # quaternions wxyz, parent-relative
    root: Float[np.ndarray, "3"]  # metres, of the hips
    face: Float[np.ndarray, " n"] | None  # the result of the sink's `faces`; None without a face
    seconds: float  # since the sink started, on its own clock
    at: int  # sample of the session's clock that is heard with it


class JsonEncoder:
    """Encodes frames as JSON."""

    def __init__(self, rig: Rig) -> None:
        names = {"names": rig.names, "parents": rig.parents, "rest": rig.rest, "face": ARKIT_NAMES}
        self._rig = msgspec.json.encode({"type": "rig", **names})
        self._next = 0.0

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 52"]:
        """The curves, unchanged."""
        return curves

    def __call__(self, frame: Frame) -> Iterator[bytes]:
        """The pose, preceded by the rig once a second."""
        if frame.seconds >= self._next:
            self._next = frame.seconds + RIG_SECONDS
            yield self._rig
        yield msgspec.json.encode(
            {
                "type": "pose",
                "seconds": round(frame.seconds, _DIGITS),
                "clock": round(frame.at / SAMPLE_RATE_HZ, _DIGITS),
                "root": _rounded(frame.root),
                "rotations": _rounded(np.roll(frame.rotations, -1, -1)),
                "face": None if frame.face is None else _rounded(frame.face),
            }
        )


def _rounded(values: np.ndarray) -> object:
    return np.round(values.astype(np.float64), _DIGITS).tolist()


class LiveLinkEncoder:
    """Encodes frames as packets of Live Link Face."""

    def __init__(self, rig: Rig, *, subject: str = "EchoAvatar", rate: float = 60.0) -> None:
        self._neck = [rig.names.index(name) for name in ("neck", "head") if name in rig.names]
        name = subject.encode()
        device = f"${uuid.uuid5(uuid.NAMESPACE_DNS, subject)}".upper().encode()
        self._head = struct.pack("<I", VERSION) + device + struct.pack("!i", len(name)) + name
        self._rate = round(rate)

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 61"]:
        """Shapes in the packet's order, and the angles of both eyes."""
        return reorder(to_live_link(curves), ARKIT_NAMES + HEAD_AND_EYES, APPLE_NAMES + HEAD_AND_EYES)

    def __call__(self, frame: Frame) -> list[bytes]:
        """The frame's packet."""
        whole, part = divmod(frame.seconds * self._rate, 1.0)
        values = np.zeros(SHAPES) if frame.face is None else frame.face.copy()
        values[_HEAD] = head_angles(frame.rotations[self._neck])
        time = struct.pack("!if2i", int(whole) % 2**31, part, self._rate, 1)
        return [self._head + time + struct.pack(f"!B{SHAPES}f", SHAPES, *values.tolist())]


def head_angles(chain: Float[np.ndarray, "k 4"]) -> Float[np.ndarray, "3"]:
    """Yaw, pitch and roll (rad) of the head relative to the trunk, from the rotations (wxyz) of neck and head."""
    whole = np.eye(3)
    for joint in matrix_from_quaternion(chain.astype(np.float64)):
        whole = whole @ joint
    yaw, pitch, roll = euler_from_matrix(whole, "yxz")
    return np.array([-yaw, pitch, roll], np.float32)


class Message(NamedTuple):
    """An address, at most one string or integer, then a number of floats."""

    address: str
    first: str | int | None
    floats: int


def padded(text: str) -> bytes:
    """A string in OSC's form: zero-terminated and padded to a multiple of four bytes."""
    raw = text.encode()
    return raw + b"\0" * (4 - len(raw) % 4)


def encoded(message: Message) -> bytes:
    """A message with all floats 0."""
    kinds, body = ",", b""
    if isinstance(message.first, str):
        kinds, body = ",s", padded(message.first)
    elif message.first is not None:
        kinds, body = ",i", struct.pack(">i", message.first)
    return padded(message.address) + padded(kinds + "f" * message.floats) + body + b"\0" * (4 * message.floats)


class Bundles:
    """Messages packed into as few bundles as possible, with the positions of their floats."""

    def __init__(self, messages: Sequence[Message], largest: int = LARGEST) -> None:
        self.packets: list[bytearray] = []
        self._slots: list[np.ndarray] = []
        packet, slots = bytearray(_BUNDLE), list[int]()
        for message in messages:
            data = encoded(message)
            if len(packet) + 4 + len(data) > largest and slots:
                self._keep(packet, slots)
                packet, slots = bytearray(_BUNDLE), []
            packet += struct.pack(">i", len(data)) + data
            end = len(packet) // 4
            slots += range(end - message.floats, end)
        self._keep(packet, slots)
        self._views = [np.frombuffer(packet, ">f4") for packet in self.packets]

    def _keep(self, packet: bytearray, slots: list[int]) -> None:
        self.packets.append(packet)
        self._slots.append(np.array(slots, np.intp))

    def fill(self, values: Float[np.ndarray, " n"]) -> list[bytearray]:
        """The packets with these floats, in the order of the messages."""
        start = 0
        for view, slots in zip(self._views, self._slots, strict=True):
            view[slots] = values[start : start + len(slots)]
            start += len(slots)
        return self.packets


def unity_bone(name: str) -> str:
    """Unity's name of a VRM 1.0 bone."""
    for vrm_name, unity_name in _THUMBS.items():
        if name.endswith(vrm_name):
            name = name.removesuffix(vrm_name) + unity_name
            break
    return name[:1].upper() + name[1:]


def expression_names(names: Names) -> tuple[str, ...]:
    """Names of the expressions: VRM 0.x or 1.0 presets, or all 52 ARKit shapes (capitalised for "perfect sync")."""
    return {
        "vrm0": _VRM0,
        "vrm1": VRM_NAMES,
        "arkit": ARKIT_NAMES,
        "perfect": tuple(name[:1].upper() + name[1:] for name in ARKIT_NAMES),
    }[names]


def to_unity(rotations: Float[np.ndarray, "j 4"], places: Float[np.ndarray, "j 3"]) -> Float[np.ndarray, "j 7"]:
    """Position and rotation (xyzw) of each bone in Unity's mirrored axes."""
    w, x, y, z = rotations.T
    return np.stack([-places[:, 0], places[:, 1], places[:, 2], x, -y, -z, w], 1)


class VmcEncoder:
    """Encodes frames as VMC bundles."""

    def __init__(self, rig: Rig, names: Names = "vrm0") -> None:
        expressions = expression_names(names)
        self._is_preset = names in ("vrm0", "vrm1")
        self._at_rest = np.zeros(len(expressions))
        self._rest = np.array(rig.rest, np.float64)
        bones = [Message("/VMC/Ext/Bone/Pos", unity_bone(name), 7) for name in rig.names]
        blends = [Message("/VMC/Ext/Blend/Val", name, 1) for name in expressions]
        self._bundles = Bundles(
            [
                Message("/VMC/Ext/OK", 1, 0),
                Message("/VMC/Ext/T", None, 1),
                Message("/VMC/Ext/Root/Pos", "root", 7),
                *bones,
                *blends,
                Message("/VMC/Ext/Blend/Apply", None, 0),
            ]
        )

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """Weights of the expressions."""
        return to_vrm(curves) if self._is_preset else curves

    def __call__(self, frame: Frame) -> list[bytearray]:
        """The bundles of a frame; the next frame reuses their buffers."""
        places = self._rest.copy()
        places[0] = frame.root
        parts = [np.array([frame.seconds, *_ROOT]), to_unity(frame.rotations, places).ravel()]
        parts.append(self._at_rest if frame.face is None else frame.face)
        return self._bundles.fill(np.concatenate(parts))


Encoder = JsonEncoder | LiveLinkEncoder | VmcEncoder
