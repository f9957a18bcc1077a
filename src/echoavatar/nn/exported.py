"""A streaming step that the lab exported as a graph: state in, state out, rows first. It needs no module of torch.

The graph lies beside `model.safetensors`, whose weights it reads. Its name ends in a hash of how that file and the
config are laid out (`graph_file`), so a graph that was made for others is not found, and the torch module runs instead.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from echoavatar.errors import CheckpointError

from .stream import StreamState

_TYPES = {"tensor(float)": torch.float32, "tensor(double)": torch.float64, "tensor(int64)": torch.int64}


def graph_file(folder: Path) -> Path:
    """Where the graph of a checkpoint lies, if it has one."""
    with (folder / "model.safetensors").open("rb") as weights:
        layout = weights.read(int.from_bytes(weights.read(8), "little"))
    digest = hashlib.sha256((folder / "config.json").read_bytes() + layout).hexdigest()
    return folder / f"step-{digest[:16]}.onnx"


@dataclass
class ExportedState(StreamState):
    """The past in the order of the graph's inputs."""

    parts: list[Tensor]

    def tensors(self) -> Iterator[Tensor]:
        """Every part."""
        return iter(self.parts)

    def rows(self, which: slice) -> "ExportedState":
        """Views of some rows."""
        return ExportedState([part[which] for part in self.parts])


class ExportedStep:
    """Runs the graph in the calling thread; several threads may run it at once."""

    def __init__(self, path: Path) -> None:
        """Load a graph and the weights beside it. Raises CheckpointError if it cannot be run."""
        import onnxruntime  # takes a tenth of a second, which only bundles with graphs pay

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # what is wrong is raised
        try:
            self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common class
            raise CheckpointError(f"{path} cannot be run ({error}); copy or download the bundle again") from error
        self._input, *self._past = self._session.get_inputs()

    def init_state(self, rows: int) -> ExportedState:
        """Nothing seen yet."""
        return ExportedState([torch.zeros(rows, *past.shape[1:], dtype=_TYPES[past.type]) for past in self._past])

    def step(self, x: Tensor, state: ExportedState, active: Bool[Tensor, " b"]) -> Tensor:
        """The graph's output for the next input of as many frames as it was made for; zero in inactive rows."""
        rows = np.flatnonzero(active.numpy())
        chosen = rows if 0 < len(rows) < len(active) else slice(None)  # without active rows all run, and none is kept
        past = [part.numpy() for part in state.parts]
        given = {i.name: part[chosen] for i, part in zip(self._past, past, strict=True)}
        made, *new = self._session.run(None, given | {self._input.name: x.numpy()[chosen]})
        if len(rows):
            for part, value in zip(past, new, strict=True):
                part[chosen] = value
        if chosen == slice(None):
            return torch.from_numpy(made)
        whole = np.zeros((len(active), *made.shape[1:]), made.dtype)
        whole[chosen] = made
        return torch.from_numpy(whole)
