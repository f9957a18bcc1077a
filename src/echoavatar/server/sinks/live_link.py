"""Live Link Face, the protocol of Epic's iPhone app: one face per packet, for MetaHumans, without a plugin. No body.

The packet orders the 52 shapes as Apple's headers and Unreal do, left before right. (The CSV that the same app writes
has the right side of jaw and mouth first.) Angles have the signs of that CSV: to the avatar's left and up is negative.
"""

import struct
import uuid

import numpy as np
from jaxtyping import Float

from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES, HEAD_AND_EYES, reorder, to_live_link
from echoavatar.wire import Rig

from .sink import Frame

VERSION = 6
SHAPES = 61
_HEAD = slice(len(ARKIT_NAMES), len(ARKIT_NAMES) + 3)


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
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    for a, b, c, d in chain:
        w, x, y, z = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
    yaw = np.arctan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * x - y * z), -1, 1))
    roll = np.arctan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))
    return np.array([-yaw, pitch, roll], np.float32)
