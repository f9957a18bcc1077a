import pytest
import torch
from lab.tests.nn.traced import trace

from echoavatar_lab.nn.graphs import KEPT, GraphCache


def count_up(state: torch.Tensor, step: int, x: torch.Tensor) -> torch.Tensor:
    """Adds to the state in place; the answer depends on it and on the input."""
    state += step
    return state * x


def cache(device: str = "cpu") -> GraphCache[torch.Tensor]:
    return GraphCache(count_up, lambda state: [state], capture=trace if device == "cpu" else None)


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_a_replay_takes_new_inputs_and_moves_its_own_state_on(device):
    graphs, x = cache(device), torch.arange(3.0, device=device)
    state, other = torch.zeros(3, device=device), torch.full((3,), 10.0, device=device)
    first = graphs(state, 1, x)
    assert first.tolist() == [0, 1, 2]  # warming up left no trace in the state
    assert graphs(state, 1, 10 * x).tolist() == [0, 20, 40]
    assert graphs(state, 5, x).tolist() == [0, 7, 14]
    assert graphs(other, 1, x).tolist() == [0, 11, 22]
    assert graphs(state, 1, x[:1]).tolist() == [0, 0, 0]
    assert state.tolist() == [8, 8, 8]
    assert first.tolist() == [0, 1, 2]


def test_without_cuda_the_function_is_called_plainly():
    state = torch.zeros(3)
    assert GraphCache(count_up, lambda state: [state])(state, 1, torch.ones(3)).tolist() == [1, 1, 1]


def test_only_the_last_states_are_kept():
    captured = []

    def capture(run):
        captured.append(run)
        return trace(run)

    graphs = GraphCache(count_up, lambda state: [state], capture=capture)
    states = [torch.zeros(1) for _ in range(KEPT + 1)]
    for state in [*states, states[-1], states[0]]:
        graphs(state, 1, torch.ones(1))
    assert len(captured) == KEPT + 2
    assert [float(state) for state in states] == [2, 1, 1, 1, 2]
