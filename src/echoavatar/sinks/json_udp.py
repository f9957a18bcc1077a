"""JSON over UDP: for those who write their own receiver in an afternoon.

A datagram a frame, `{"type": "pose", ...}`, and once a second `{"type": "rig", ...}` with the names that the numbers go
by. Our axes: metres, Y up, facing +Z, left +X; quaternions as x y z w, relative to the parent.
"""

from collections.abc import Iterator

import msgspec
import numpy as np
from jaxtyping import Float

from ..face.arkit import ARKIT_NAMES
from ..timing import SAMPLE_RATE_HZ
from ..wire import Rig
from .sink import Frame

RIG_SECONDS = 1.0
_DIGITS = 5


class JsonEncoder:
    """Frames as JSON."""

    def __init__(self, rig: Rig) -> None:
        names = {"names": rig.names, "parents": rig.parents, "rest": rig.rest, "face": ARKIT_NAMES}
        self._rig = _packed({"type": "rig", **names})
        self._next = 0.0

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 52"]:
        """As they are."""
        return curves

    def __call__(self, frame: Frame) -> Iterator[bytes]:
        """The pose, and now and then the rig before it."""
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
