"""Collect arrays in the binary chunk of a GLB, each with its view and accessor, aligned to four bytes."""

from typing import Any

import numpy as np
from jaxtyping import Float

FLOAT, UBYTE, USHORT, SHORT, UINT = 5126, 5121, 5123, 5122, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
COMPONENT = {"float32": FLOAT, "uint8": UBYTE, "uint16": USHORT, "int16": SHORT, "uint32": UINT}
SHAPE = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class Buffer:
    """The bytes collected so far, with their views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self,
        values: np.ndarray,
        *,
        target: int | None = None,
        bounds: bool = False,
        normalized: bool = False,
        shape: str = "",
    ) -> int:
        """Append one array as view and accessor; return the accessor's index."""
        values = np.ascontiguousarray(values)
        accessor: dict[str, Any] = {
            "bufferView": self.view(values, target=target),
            "componentType": COMPONENT[values.dtype.name],
            "count": len(values),
            "type": shape or SHAPE[values.shape[1:]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": np.atleast_1d(values.min(0)).tolist(), "max": np.atleast_1d(values.max(0)).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def view(self, values: np.ndarray, *, target: int | None = None) -> int:
        """Append one array as a view; return the view's index."""
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        self.data += np.ascontiguousarray(values).tobytes()
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append(view)
        return len(self.views) - 1

    def sparse(self, count: int, indices: int, values: Float[np.ndarray, "m 3"], *, bounds: bool = False) -> int:
        """Add an accessor of `count` vectors: `values` at the places in the view `indices` (16 bit), 0 elsewhere."""
        accessor: dict[str, Any] = {"componentType": FLOAT, "count": count, "type": "VEC3"}
        if len(values):
            places = {"bufferView": indices, "componentType": USHORT}
            filled = {"bufferView": self.view(values.astype(np.float32))}
            accessor["sparse"] = {"count": len(values), "indices": places, "values": filled}
        if bounds:
            extremes = values.astype(np.float32)
            if len(values) < count:
                extremes = np.concatenate([extremes, np.zeros((1, 3), np.float32)])
            accessor |= {"min": extremes.min(0).tolist(), "max": extremes.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


class Tracks:
    """Samplers and channels of one animation, on one clock."""

    def __init__(self, buffer: Buffer, frames: int, fps: float) -> None:
        self.buffer = buffer
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self._clock = buffer.add((np.arange(frames) / fps).astype(np.float32), bounds=True)

    def add(self, node: int, path: str, values: np.ndarray) -> None:
        """Animate a node's rotation (xyzw), translation or weights; integers are stored as they are, normalised."""
        is_float = values.dtype.kind == "f"
        stored = values.astype(np.float32) if is_float else values
        self.channels.append({"sampler": len(self.samplers), "target": {"node": node, "path": path}})
        output = self.buffer.add(stored, normalized=not is_float)
        self.samplers.append({"input": self._clock, "interpolation": "LINEAR", "output": output})
