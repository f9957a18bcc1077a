"""Rounding to int8 keeps the mean of a matrix, and integers that are there already."""

import numpy as np
import pytest

from echoavatar.errors import CheckpointError
from echoavatar.models.audio import CodecConfig
from echoavatar.stored import check_shapes, read_config, round_to_int8


def test_rounding_keeps_the_mean_and_what_is_rounded() -> None:
    weight = np.random.default_rng(0).normal(size=(8, 4096)).astype(np.float32)
    rounded = round_to_int8(weight)
    assert np.abs(rounded.floats() - weight).max() <= rounded.scale.max() * 1.001
    assert np.abs((rounded.floats() - weight).mean(1)).max() < rounded.scale.max() / 20
    assert np.array_equal(round_to_int8(rounded.floats()).integers, rounded.integers)


def test_a_folder_without_config_and_a_weight_of_another_shape_are_named(tmp_path) -> None:
    with pytest.raises(CheckpointError, match="config.json is missing"):
        read_config(tmp_path, CodecConfig)
    with pytest.raises(CheckpointError, match="bias"):
        check_shapes({"bias": (3,)}, {"bias": (4,)}, origin="here")
