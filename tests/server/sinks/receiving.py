"""A UDP receiver, a rig, and frames that differ from each other."""

import contextlib
import socket
import time
from collections.abc import Callable

import numpy as np

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.server.sinks import Frame
from echoavatar.server.sinks.encoders import Encoder
from echoavatar.wire.blobs import Pose
from echoavatar.wire.messages import Rig

_CONFIG = HUMANOID.config
RIG = Rig(names=_CONFIG.names, parents=_CONFIG.parents, rest=_CONFIG.offsets)


class Receiver:
    """A UDP port; packets are returned with the time at which they were read."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5)
        self.port = self.socket.getsockname()[1]

    def packets(self, count: int) -> list[tuple[float, bytes]]:
        return [(time.monotonic(), self.socket.recv(65_536)) for _ in range(count)][:count]

    def empty(self) -> None:
        """Discard what has arrived so far."""
        self.socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self.socket.recv(65_536)
        self.socket.settimeout(5)

    def until(self, test: Callable[[bytes], bool], seconds: float = 10) -> bytes:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            packet = self.socket.recv(65_536)
            if test(packet):
                return packet
        raise AssertionError("no such packet came")

    def __enter__(self) -> "Receiver":
        return self

    def __exit__(self, *reason: object) -> None:
        self.socket.close()


def shown(encoder: Encoder, frame: Frame) -> Frame:
    """The frame with its face converted for this encoder."""
    return frame if frame.face is None else frame._replace(face=encoder.faces(frame.face[None])[0])


def random_frame(seed: int = 0, *, has_face: bool = True) -> Frame:
    draw = np.random.default_rng(seed)
    rotations = draw.normal(size=(len(RIG.names), 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    face = draw.uniform(size=52).astype(np.float32) if has_face else None
    return Frame(rotations.astype(np.float32), draw.normal(size=3).astype(np.float32), face, 12.345, 4800)


def walking(frames: int, *, start: float = 0.0) -> Pose:
    """Frames at rest whose hips advance one metre per second."""
    rotations = np.zeros((frames, len(RIG.names), 4), np.float32)
    rotations[..., 0] = 1
    root = np.tile(np.float32([0, 0.95, 0]), (frames, 1))
    root[:, 2] = start + np.arange(frames) / 30
    return Pose(rotations, root, np.zeros((frames, 52), np.float32))
