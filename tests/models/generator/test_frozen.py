"""Weights of a generator as the compiled loop reads them: each fits the config, and rounding costs little."""

import numpy as np
from tests.models.generator.tiny import generator

from echoavatar.models.generator.frozen import Frozen, shapes


def test_the_shapes_are_those_of_the_module() -> None:
    own = generator(sequence="depth")
    have = {name: tuple(weight.shape) for name, weight in own.state_dict().items()}
    wanted = shapes(own.config)
    assert wanted
    assert all(have[name] == shape for name, shape in wanted.items())


def test_floats_are_those_that_were_stored() -> None:
    arrays = {name: weight.detach().numpy() for name, weight in generator(sequence="depth").state_dict().items()}
    frozen = Frozen(arrays, rounds=False)
    for name, array in arrays.items():
        assert name in frozen
        assert np.array_equal(frozen.floats(name), array)
