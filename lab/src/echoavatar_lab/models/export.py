"""Streaming steps of trained modules as graphs that run without torch: state in, state out, rows first.

`torch.onnx` makes the graph from the module's own `step`, so there is no second implementation to keep in step. The
weights stay where they are: the graph reads them from the checkpoint's `model.safetensors`, in the precision in which
they are stored there, and the runtime makes them float32 once, when it loads them.
"""

import json
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import GeneratorConfig
from echoavatar.nn import StreamState
from echoavatar.nn.exported import ExportedStep, graph_file
from echoavatar.stored import WEIGHTS, read_config
from echoavatar.timing import SAMPLES_PER_FRAME, ChunkSize
from echoavatar.whole_file import write_whole
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.face.encoder import MelEncoder
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

OPSET = 23  # has attention as one operation
ROWS = 2  # of the examples that are traced; a graph takes any number
TOLERANCE = 1e-4  # between a graph and its module
_STORED = {"F32": "FLOAT", "F16": "FLOAT16"}
_LARGE = 1024  # elements; smaller constants are computed when the graph is made


class _Step(nn.Module):
    """A step of some rows that are all active, as a function of tensors."""

    def __init__(self, owner: nn.Module, step: Callable[[Tensor, Any, Tensor], Tensor], state: StreamState) -> None:
        super().__init__()
        self.owner, self._step, self._state = owner, step, state

    def forward(self, x: Tensor, past: list[Tensor]) -> tuple[Tensor, ...]:
        """The step's output, then the new state."""
        given = iter([part.clone() for part in past])
        state = self._state.mapped(lambda _: next(given))
        made = self._step(x, state, torch.ones(x.shape[0], dtype=torch.bool))
        return (made, *state.arrays())


def export_bundle(folder: Path) -> None:
    """Write the graphs of a bundle's codec, tokenizer (both ways) and face. Raises as `export_step`."""
    chunk = ChunkSize(read_config(folder / "generator", GeneratorConfig).step)
    export_codec(folder / "codec", chunk)
    export_tokenizer(folder / "tokenizer", chunk)
    if (folder / "face").is_dir():
        export_ear(folder / "face")


def export_codec(folder: Path, chunk: ChunkSize) -> Path:
    """Write the graph of a codec's encoder: sound of a chunk to codes. Raises as `export_step`."""
    codec, sound = AudioCodec.load(folder), 0.1 * torch.randn(ROWS, chunk.samples)
    return export_step(folder, codec, codec.step, codec.init_state, sound)


def export_tokenizer(folder: Path, chunk: ChunkSize) -> tuple[Path, Path]:
    """Write the graphs of a tokenizer: codes of a chunk to features, and features to codes. Raises as `export_step`."""
    tokenizer = BodyTokenizer.load(folder)
    config = tokenizer.config
    codes = torch.randint(config.codes, (ROWS, chunk.tokens, len(config.parts), config.layers))
    features = tokenizer.decode(codes)
    return (
        export_step(folder, tokenizer, tokenizer.decode_step, tokenizer.init_decoder, codes),
        export_step(folder, tokenizer, tokenizer.encode_step, tokenizer.init_encoder, features, name="encoder"),
    )


def export_ear(folder: Path) -> Path | None:
    """Write the graph of a face's ear: sound of a step to what its frames hear. Raises as `export_step`.

    None for an encoder that reads windows.
    """
    model = FaceModel.load(folder)
    if model.config.memory != "ring" or not isinstance(model.encoder, MelEncoder):
        return None
    sound = 0.1 * torch.randn(ROWS, model.config.step * SAMPLES_PER_FRAME)
    return export_step(folder, model, model.hear, model.encoder.init_state, sound)


def export_step(
    folder: Path,
    owner: nn.Module,
    step: Callable[[Tensor, Any, Tensor], Tensor],
    init_state: Callable[[int], StreamState],
    x: Tensor,
    *,
    name: str = "step",
) -> Path:
    """Write the graph of a step for inputs like `x`, of any number of rows, into the checkpoint's folder.

    Args:
        folder: the checkpoint.
        owner: the module with the checkpoint's weights, under the names that they have there.
        step: the step, which may use nothing but `owner`.
        init_state: makes its state.
        x: an example of its input, of several rows.
        name: the graph's, before the hash.

    Raises:
        EchoAvatarError: the graph does not compute what the step computes.
    """
    import onnx
    from onnxscript import optimizer

    state, rows = init_state(len(x)), {0: torch.export.Dim("rows", min=1, max=4096)}
    past = list(state.arrays())
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch about itself
        program = torch.onnx.export(
            _Step(owner, step, state).eval(),
            (x, past),
            input_names=["x", *(f"past.{index}" for index in range(len(past)))],
            output_names=["y", *(f"next.{index}" for index in range(len(past)))],
            dynamic_shapes=(rows, [rows for _ in past]),
            opset_version=OPSET,
            optimize=False,
            verbose=False,
        )
    assert program is not None
    optimizer.optimize_ir(
        program.model,
        input_size_limit=_LARGE,
        output_size_limit=4 * _LARGE,
        should_fold=lambda node: False if node.op_type == "Transpose" else None,  # it would copy the weights
    )
    with tempfile.TemporaryDirectory() as scratch:
        program.save(Path(scratch) / "graph.onnx", external_data=False)
        graph = onnx.load(Path(scratch) / "graph.onnx")
    _read_from_checkpoint(graph, folder / WEIGHTS)
    for old in folder.glob(f"{name}-*.onnx"):
        old.unlink()
    path = graph_file(folder, name)
    write_whole(path, graph.SerializeToString())
    _compare(ExportedStep(path), step, init_state, x)
    return path


def _compare(
    exported: ExportedStep,
    step: Callable[[Tensor, Any, Tensor], Tensor],
    init_state: Callable[[int], StreamState],
    x: Tensor,
) -> None:
    """Raise EchoAvatarError if a few steps differ."""
    own, other, everyone = init_state(len(x)), exported.init_state(len(x)), np.ones(len(x), np.bool_)
    for _ in range(3):
        with torch.no_grad():
            wanted, made = step(x, own, torch.from_numpy(everyone)), exported.step(x.numpy(), other, everyone)
        error = float(np.abs(made.astype(np.float64) - wanted.numpy()).max())
        if not error <= TOLERANCE:
            raise EchoAvatarError(f"the graph is off by {error:.2g} from its module; try another version of torch")


def _read_from_checkpoint(model: Any, weights: Path) -> None:
    """Let a graph's weights be those of the checkpoint, cast where they are stored in half precision."""
    from onnx import TensorProto, external_data_helper, helper

    with weights.open("rb") as file:
        header = int.from_bytes(file.read(8), "little")
        stored = json.loads(file.read(header))
    casts = []
    for weight in model.graph.initializer:
        entry = stored.get(weight.name.removeprefix("owner."))
        if entry is None or entry["dtype"] not in _STORED or entry["shape"] != list(weight.dims):
            continue
        if entry["dtype"] != "F32":
            casts.append(helper.make_node("Cast", [weight.name + ".stored"], [weight.name], to=TensorProto.FLOAT))
            weight.name += ".stored"
        first, last = entry["data_offsets"]
        weight.data_type = getattr(TensorProto, _STORED[entry["dtype"]])
        weight.raw_data = b""
        external_data_helper.set_external_data(weight, weights.name, 8 + header + first, last - first)
        weight.ClearField("raw_data")
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    del model.graph.value_info[:]
    del model.metadata_props[:]
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
