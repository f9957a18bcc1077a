"""The five laws, for the encoder with its codebooks and with both ways of padding."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.laws.streaming import hold
from tests.models.audio.small_codec import ours, reference

from echoavatar.models.audio import AudioCodec, CodecConfig
from echoavatar.models.audio.stream import advance, init_network_state, shortest_start
from echoavatar_lab.models.audio.train import balance

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
    assert not any(tensor.requires_grad for tensor in state.tensors())


def test_shortest_start_is_seven_frames_with_reflections():
    """The last convolution reflects 6 latent frames, so it needs a seventh."""
    assert shortest_start(CODECS["reflect"].encoder, "reflect") == 7
    assert shortest_start(CODECS["constant"].encoder, "constant") == 1
