"""The five laws, for the encoder with its codebooks and with both ways of padding."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from tests.laws.streaming import hold
from tests.models.audio.small_codec import ours, reference
from torch import nn

from echoavatar.models.audio import CodecConfig
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.network import (
    advance,
    convolve,
    convolve_transposed,
    decoder,
    encoder,
    init_network_state,
    lookback,
    shortest_start,
)
from echoavatar_lab.models.audio.train import balance


def test_ratios_that_break_the_clock_and_odd_codebook_sizes_are_refused():
    with pytest.raises(ValidationError, match="product of ratios is 160, wanted 320"):
        CodecConfig(ratios=(8, 5, 4))
    with pytest.raises(ValidationError, match="power of two"):
        CodecConfig(codes=500)


@pytest.mark.parametrize(("blocks", "shortcut"), [(0, False), (1, True), (2, False)])
def test_the_weights_have_the_published_names_and_shapes(blocks: int, shortcut: bool) -> None:
    """What they compute is compared in test_codec."""
    theirs = reference(num_residual_layers=blocks, use_conv_shortcut=shortcut, num_filters=4)
    config = CodecConfig(filters=4, width=16, residual_blocks=blocks, has_conv_shortcut=shortcut)
    for network, wanted in ((encoder(config), theirs.encoder), (decoder(config), theirs.decoder)):
        shapes = {
            name.replace("parametrizations.weight.original1", "weight"): weight.shape
            for name, weight in wanted.named_parameters()
            if not name.endswith("original0")
        }
        assert {name: weight.shape for name, weight in network.named_parameters()} == shapes


def test_fresh_weights_keep_the_loudness() -> None:
    torch.manual_seed(0)
    layer = encoder(CodecConfig(filters=64)).layers[2].conv
    heard = torch.randn(1, 64, 4_000).relu()
    assert 0.8 < layer(heard).std() / heard.square().mean().sqrt() / 2**0.5 < 1.25


@pytest.mark.parametrize(
    ("channels", "kernel", "stride", "dilation"),
    [(1, 7, 1, 1), (4, 3, 1, 2), (4, 1, 1, 1), (4, 16, 8, 1), (4, 7, 1, 1)],
)
@pytest.mark.parametrize("has_bias", [True, False])
def test_convolution_equals_torch(channels, kernel, stride, dilation, has_bias):
    conv = nn.Conv1d(channels, 6, kernel, stride, dilation=dilation, bias=has_bias).double()
    x = torch.randn(2, lookback(conv) + 5 * stride, channels, dtype=torch.double)
    torch.testing.assert_close(convolve(conv, x), conv(x.transpose(1, 2)).transpose(1, 2))


@pytest.mark.parametrize(("kernel", "stride"), [(4, 2), (16, 8), (5, 5), (6, 2)])
def test_transposed_convolution_equals_torch_cut_to_the_causal_part(kernel, stride):
    """Torch's output of x behind k zeros starts k strides early and ends kernel - stride samples late."""
    conv = nn.ConvTranspose1d(4, 3, kernel, stride).double()
    x = torch.randn(2, 7, 4, dtype=torch.double)
    whole = conv(x.transpose(1, 2)).transpose(1, 2)[:, : 7 * stride]
    padded = torch.cat([x.new_zeros(2, lookback(conv), 4), x], 1)
    torch.testing.assert_close(convolve_transposed(conv, padded), whole)


ALL = torch.ones(3, dtype=torch.bool)


def make(padding: str = "constant") -> AudioCodec:
    torch.manual_seed(3)
    config = CodecConfig(filters=2, width=8, codes=32, padding=padding, residual_blocks=1, has_conv_shortcut=True)
    codec = AudioCodec(config).eval()
    balance(codec, seed=3)  # fresh weights alone give nearly constant latents
    codec.codebooks.normal_()
    return codec.double()


CODECS = {padding: make(padding) for padding in ("constant", "reflect")}


@settings(max_examples=15, deadline=None)
@given(cuts=st.lists(st.integers(1, 7), min_size=1, max_size=6))
def test_any_chunking_gives_the_offline_answer(cuts):
    codec, audio = CODECS["constant"], torch.randn(3, 320 * sum(cuts), dtype=torch.double)
    state = codec.init_state(3)
    parts = [codec.latents(part, state, ALL) for part in audio.split([320 * cut for cut in cuts], dim=1)]
    whole = codec.latents(audio, codec.init_state(3), ALL)
    torch.testing.assert_close(torch.cat(parts, 1), whole, atol=1e-12, rtol=0)


@pytest.mark.parametrize("padding", CODECS)
def test_the_five_laws_hold(padding):
    """In steps of seven frames, which reflections need at the start."""
    hold(CODECS[padding], lambda rows, samples, g: torch.randn(rows, samples, generator=g).double(), unit=7 * 320)


def test_the_decoder_streams_by_the_same_code(tmp_path):
    """Outside witness of the transposed convolutions: transformers' decoder, offline."""
    model = reference(pad_mode="constant").double()
    codec, latents = ours(model, tmp_path).double(), torch.randn(3, 9, 16, dtype=torch.double)
    state = init_network_state(codec.decoder, 3)
    with torch.no_grad():
        parts = [advance(codec.decoder, x, state, ALL, padding="constant") for x in latents.split([2, 1, 6], 1)]
        wanted = model.decoder(latents.transpose(1, 2))[:, 0]
    torch.testing.assert_close(torch.cat(parts, 1)[..., 0], wanted, atol=1e-6, rtol=0)


def test_gradients_pass_through_a_step():
    codec = make()
    state = codec.init_state(3)
    codec.latents(torch.randn(3, 3_200), state, ALL).square().mean().backward()
    assert all(parameter.grad is not None for parameter in codec.encoder.parameters())
    assert not any(tensor.requires_grad for tensor in state.arrays())


def test_shortest_start_is_seven_frames_with_reflections():
    """The last convolution reflects 6 latent frames, so it needs a seventh."""
    assert shortest_start(CODECS["reflect"].encoder, "reflect") == 7
    assert shortest_start(CODECS["constant"].encoder, "constant") == 1
