"""A streaming step that echoavatar-lab exported as an ONNX graph: state in, state out, rows first; without torch.

The graph lies beside `model.safetensors`, whose weights it reads. Its name ends in a hash of that file and the config
(`graph_file`). So a graph that was made from other weights is not found, and the lab's torch module runs instead.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped

from echoavatar.errors import CheckpointError
from echoavatar.stored import WEIGHTS

from .state import StreamState

_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(int64)": np.int64}


def graph_file(folder: Path, name: str = "step") -> Path:
    """The path that a checkpoint's graph has, whether or not there is one."""
    with (folder / WEIGHTS).open("rb") as weights:
        digest = hashlib.file_digest(weights, "sha256")
    digest.update((folder / "config.json").read_bytes())
    return folder / f"{name}-{digest.hexdigest()[:16]}.onnx"


@dataclass
class ExportedState(StreamState):
    """The graph's state, in the order of its inputs."""

    parts: list[Shaped[np.ndarray, "b ..."]]


class ExportedStep:
    """Runs the graph in the calling thread; several threads may run it at once."""

    def __init__(self, path: Path) -> None:
        """Load a graph and the weights beside it. Raises CheckpointError if it cannot be run."""
        import onnxruntime  # takes a tenth of a second, so only bundles with graphs load it

        onnxruntime.disable_telemetry_events()
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # errors are raised, not logged
        weights = (path.parent / WEIGHTS).read_bytes()  # onnxruntime follows no links, as the hub's cache has
        options.add_external_initializers_from_files_in_memory([WEIGHTS], [weights], [len(weights)])
        try:
            self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors have no common class
            raise CheckpointError(f"{path} cannot be run ({error}); copy or download the bundle again") from error
        inputs = self._session.get_inputs()
        self._past, self._names = inputs[1:], [one.name for one in inputs]
        is_known = all(one.type in _TYPES and all(isinstance(n, int) for n in one.shape[1:]) for one in self._past)
        if not (inputs and is_known and len(inputs) == len(self._session.get_outputs())):
            raise CheckpointError(f"{path} is not a step with a state; copy or download the bundle again")

    def init_state(self, rows: int) -> ExportedState:
        """Nothing seen yet."""
        return ExportedState([np.zeros((rows, *past.shape[1:]), _TYPES[past.type]) for past in self._past])

    def step(
        self, x: Shaped[np.ndarray, "b ..."], state: ExportedState, active: Bool[np.ndarray, " b"]
    ) -> Shaped[np.ndarray, "b ..."]:
        """The output for the next frames, as many as the graph was made for; that of inactive rows means nothing.

        Each row runs by itself, because a batch may sum a matrix product in another order than a single row.
        """
        past, outputs = state.parts, list[np.ndarray]()
        for row, is_active in enumerate(active.tolist()):
            if not (is_active or not outputs):  # the first row always runs, so that there is an output
                outputs.append(outputs[0])
                continue
            own = slice(row, row + 1)
            given = zip(self._names, [x[own], *(part[own] for part in past)], strict=True)
            made, *new = self._session.run(None, dict(given))
            for part, value in zip(past, new, strict=True) if is_active else ():
                part[own] = value
            outputs.append(made)
        return np.concatenate(outputs)
