"""Codes, and what their vectors sum to."""

import pytest
import torch
from tests.models.motion_tokens import fill

from echoavatar_lab.models.quantize import Codebook, ResidualVectorQuantizer


@pytest.fixture
def quantizer() -> ResidualVectorQuantizer:
    torch.manual_seed(0)
    made = ResidualVectorQuantizer(codes=16, width=8, layers=3)
    fill(made)
    return made


def test_a_code_of_minus_one_is_the_zero_vector():
    book = Codebook(codes=2, width=3)
    book.codebook.fill_(1)
    assert torch.equal(book.lookup(torch.tensor([0, -1])), torch.tensor([[1.0, 1, 1], [0, 0, 0]]))


def test_each_layer_takes_the_code_nearest_to_what_is_left_over(quantizer):
    x = torch.randn(2, 5, 8)
    codes = quantizer.encode(x)
    for layer, book in enumerate(quantizer.books()):
        left = x - (quantizer.decode(codes[..., :layer]) if layer else 0)
        distances = torch.cdist(left.flatten(0, 1), book.codebook)
        assert torch.equal(codes[..., layer].flatten(), distances.argmin(1))


def test_missing_trailing_layers_equal_layers_of_minus_one(quantizer):
    codes = quantizer.encode(torch.randn(2, 5, 8))
    masked = codes.clone()
    masked[..., 1:] = -1
    assert torch.equal(quantizer.decode(codes[..., :1]), quantizer.decode(masked))


def test_more_layers_of_codes_than_codebooks_are_refused(quantizer):
    with pytest.raises(ValueError, match="4 layers of codes for a quantizer of 3"):
        quantizer.decode(torch.zeros(1, 2, 4, dtype=torch.int64))


def test_state_dict_has_the_released_names_only(quantizer):
    assert list(quantizer.state_dict()) == [f"layers.{layer}.codebook" for layer in range(3)]
