"""Mixed weights lie where the shares say, and only weights of one vocabulary are mixed."""

import pytest
import torch
from tests.models.generator.tiny import generator

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.soup import soup


def moved(start, by: float):
    model = type(start)(start.config)
    model.load_state_dict({name: value + by for name, value in start.state_dict().items()})
    return model


def test_shares_say_how_far_each_run_counts():
    start = generator()
    mixed = soup(start, {"a": (moved(start, 1.0), 0.5), "b": (moved(start, 2.0), 0.25)})
    for name, value in start.state_dict().items():
        torch.testing.assert_close(mixed.state_dict()[name], value + 1.0)
    whole = soup(start, {"a": (moved(start, 1.0), 1.0)})
    torch.testing.assert_close(whole.lm_head.weight, start.lm_head.weight + 1.0)


def test_another_order_is_refused():
    with pytest.raises(CheckpointError, match="run other has another sequence: prefix"):
        soup(generator(), {"other": (generator(sequence="prefix"), 1.0)})
