"""The captured step and its plain twin."""

import pytest
import torch

from echoavatar.nn.graphs import Graphed


def test_the_twin_is_the_function_on_inputs_of_its_own() -> None:
    x = torch.arange(3.0)
    double = Graphed(lambda value: value * 2, x)
    assert not double.is_captured
    x += 1  # what the caller keeps does not matter
    assert double(torch.ones(3)).tolist() == [2, 2, 2]
    with pytest.raises(ValueError, match="shorter|longer"):
        double(x, x)


@pytest.mark.gpu
def test_a_captured_step_answers_as_its_twin() -> None:
    weight = torch.randn(8, 8, device="cuda")
    graph = Graphed(lambda x: torch.tanh(x @ weight), torch.zeros(2, 8, device="cuda"))
    x = torch.randn(2, 8, device="cuda")
    assert graph.is_captured
    torch.testing.assert_close(graph(x), torch.tanh(x @ weight))
