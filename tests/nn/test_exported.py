"""A graph with a state: it adds its input to what it heard before, and tells the sum."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from echoavatar.errors import CheckpointError
from echoavatar.nn.exported import ExportedStep, graph_file

ROW = ["rows", 2]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    (tmp_path / "config.json").write_text("{}")
    nodes = [helper.make_node("Add", ["x", "past"], ["y"]), helper.make_node("Identity", ["y"], ["new"])]
    save(graph_file(tmp_path), nodes, {"x": ROW, "past": ROW}, {"y": ROW, "new": ROW})
    return graph_file(tmp_path)


def save(
    path: Path,
    nodes: list[onnx.NodeProto],
    inputs: dict[str, list[str | int]],
    outputs: dict[str, list[str | int]],
    kind: int = TensorProto.FLOAT,
) -> None:
    sides = [[helper.make_tensor_value_info(name, kind, shape) for name, shape in side.items()]
             for side in (inputs, outputs)]  # fmt: skip
    graph = helper.make_graph(nodes, "sum", *sides)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10), path)


def test_rows_keep_their_own_past_and_those_that_rest_are_not_touched(path: Path) -> None:
    step, x = ExportedStep(path), np.float32([[1, 2], [10, 20]])
    state = step.init_state(2)
    assert step.step(x, state, np.array([True, True])).tolist() == [[1, 2], [10, 20]]
    assert step.step(x, state, np.array([False, True]))[1].tolist() == [20, 40]
    assert step.step(x, state.rows(slice(0, 1)), np.array([True, False]))[0].tolist() == [2, 4]
    assert state.parts[0].tolist() == [[2, 4], [20, 40]]
    state.reset(np.array([True, False]))
    assert step.step(x, state, np.array([True, True])).tolist() == [[1, 2], [30, 60]]


def test_without_an_active_row_nothing_is_kept(path: Path) -> None:
    step = ExportedStep(path)
    state = step.init_state(1)
    step.step(np.ones((1, 2), np.float32), state, np.array([False]))
    assert not state.parts[0].any()


def test_a_graph_of_other_weights_is_not_found_and_a_damaged_one_is_named(path: Path) -> None:
    path.write_bytes(b"no graph")
    with pytest.raises(CheckpointError, match=path.name):
        ExportedStep(path)
    (path.parent / "model.safetensors").write_bytes(b"others")
    assert not graph_file(path.parent).exists()


@pytest.mark.parametrize(
    ("outputs", "shape", "kind"),
    [
        (["y"], ROW, TensorProto.FLOAT),
        (["y", "new"], ["rows", "any"], TensorProto.FLOAT),
        (["y", "new"], ROW, TensorProto.INT32),
    ],
)
def test_a_graph_whose_state_cannot_be_made_is_named(
    path: Path, outputs: list[str], shape: list[str | int], kind: int
) -> None:
    nodes = [helper.make_node("Add", ["x", "past"], [name]) for name in outputs]
    save(path, nodes, {"x": shape, "past": shape}, dict.fromkeys(outputs, shape), kind)
    with pytest.raises(CheckpointError, match=f"{path.name} is not a step with a state"):
        ExportedStep(path)


def test_nothing_is_reported_to_the_maker_of_the_runtime(tmp_path: Path) -> None:
    """Its cache folder, into which it would write the number of the machine, stays empty."""
    code = "from echoavatar import load\nload('default')\nimport os\nassert os.environ['ORT_DISABLE_TELEMETRY'] == '1'"
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | home)
    assert not [path for path in tmp_path.rglob("*") if "elemetry" in path.name or "onnxruntime" in path.name.lower()]
