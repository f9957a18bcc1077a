"""JSON over UDP, the simplest format to write a receiver for.

Each frame is one datagram, `{"type": "pose", ...}`. Once a second `{"type": "rig", ...}` names the joints and curves.
Axes are ours: metres, Y up, facing +Z, left +X; quaternions are x y z w, relative to the parent.
"""

from collections.abc import Iterator

import msgspec
import numpy as np
from jaxtyping import Float

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire import Rig

from .sink import Frame

RIG_SECONDS = 1.0
_DIGITS = 5


class JsonEncoder:
    """Encodes frames as JSON."""

    def __init__(self, rig: Rig) -> None:
        names = {"names": rig.names, "parents": rig.parents, "rest": rig.rest, "face": ARKIT_NAMES}
        self._rig = _packed({"type": "rig", **names})
        self._next = 0.0

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 52"]:
        """The curves, unchanged."""
        return curves

    def __call__(self, frame: Frame) -> Iterator[bytes]:
        """The pose, preceded by the rig once a second."""
        if frame.seconds >= self._next:
            self._next = frame.seconds + RIG_SECONDS
            yield self._rig
        yield _packed(
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


def _packed(what: object) -> bytes:
    return msgspec.json.encode(what)
