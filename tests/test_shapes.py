"""Shapes in annotations are checked while tests run."""

import os
from typing import Any

import numpy as np
import pytest
import torch
from jaxtyping import Float, TypeCheckError, jaxtyped
from tests.shapes import checked

from echoavatar_lab.models.quantize import Codebook
from echoavatar_lab.nn.attention import lookback_mask
from echoavatar_lab.nn.stream import write_rows

hooked = pytest.mark.skipif(not os.environ.get("CHECK_SHAPES"), reason="needs CHECK_SHAPES=1, as in `make test`")


@hooked
def test_a_wrong_shape_in_a_call_of_the_package_raises() -> None:
    """One flag per row is asked for: a column of flags would go through and write something else."""
    with pytest.raises(TypeCheckError, match="active"):
        write_rows(torch.zeros(2, 3), torch.ones(2, 3), torch.ones(2, 1, dtype=torch.bool))
    with pytest.raises(TypeCheckError, match="active"):
        write_rows(torch.zeros(2, 3), torch.ones(2, 3), torch.ones(2))


@hooked
def test_methods_and_results_are_checked() -> None:
    with pytest.raises(TypeCheckError, match="codes"):
        Codebook(codes=4, width=2).lookup(torch.zeros(3))
    assert lookback_mask(2, 1).shape == (2, 2)


@jaxtyped(typechecker=checked)
def first(
    clips: list[Float[np.ndarray, " s"]], either: Float[np.ndarray, " n"] | None, fake: Codebook
) -> Float[np.ndarray, " n"]:
    return clips[0]


def test_plain_types_and_the_items_of_lists_are_left_alone() -> None:
    unlike: Any = object()
    assert len(first([np.zeros(3), np.zeros(5)], None, unlike)) == 3
    with pytest.raises(TypeCheckError, match="either"):
        first([np.zeros(3)], np.zeros((3, 1)), unlike)
    with pytest.raises(TypeCheckError, match="return value"):
        first([np.zeros(3)], np.zeros(4), unlike)
