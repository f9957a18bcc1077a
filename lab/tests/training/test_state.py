import pytest
import torch
from lab.tests.training.line import CONFIG, Line
from safetensors.torch import save_file

from echoavatar.errors import CheckpointError
from echoavatar_lab.training import Loop, has_state
from echoavatar_lab.training.state import FILE, module_state, read, write


def test_facts_and_tensors_come_back_and_nothing_half_written_is_left(tmp_path):
    write(tmp_path / FILE, {"a": torch.arange(3)}, {"step": 4})
    tensors, facts = read(tmp_path / FILE)
    assert tensors["a"].tolist() == [0, 1, 2]
    assert facts == {"step": 4}
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


def test_buffers_outside_the_state_dict_are_saved():
    stage = Line()
    stage.modules["mean"].value.fill_(3.0)
    assert module_state(stage.modules)["beside.mean..value"] == 3.0


def test_optimisers_remember_by_name():
    loop = Loop(Line(CONFIG))
    loop.advance()
    from echoavatar_lab.training.state import optimiser_state

    kept = optimiser_state(loop.stage.modules, loop.optimisers)
    assert set(kept) >= {"optimiser.layers.0.weight.exp_avg", "optimiser.layers.1.bias.step"}


def test_runs_of_other_versions_are_refused_with_a_way_out(tmp_path):
    save_file({"a": torch.zeros(1)}, tmp_path / FILE, metadata={"step": "3"})
    with pytest.raises(CheckpointError, match=f"{FILE} was written by another version.*--start"):
        Loop(Line()).resume(tmp_path)


def test_a_damaged_file_says_what_to_do(tmp_path):
    assert not has_state(tmp_path)
    (tmp_path / FILE).write_bytes(b"half a file")
    assert has_state(tmp_path)
    with pytest.raises(CheckpointError, match="is damaged .* delete it to start again"):
        Loop(Line()).resume(tmp_path)
