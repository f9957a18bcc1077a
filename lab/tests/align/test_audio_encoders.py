"""Codec tokens, BEATs and Wav2CLIP give states in time; waveforms are decoded from the codec's tokens."""

import math

import pytest
import torch
from pydantic import ValidationError

from echoavatar.engine.pipeline import load_bundle
from echoavatar.models.audio import AudioCodec, CodecConfig
from echoavatar_lab.align.audio_encoders import AudioEncoderConfig, WaveformEncoder, decoded_waveform, sinusoids
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.align.beats_encoder import Beats, BeatsConfig
from echoavatar_lab.align.wav2clip import Wav2Clip, Wav2ClipConfig

CODEC = CodecConfig(filters=4, width=8, codes=16, lstm_layers=1)
NETWORKS = {
    "beats": lambda: Beats(BeatsConfig(layers=1, width=16, heads=2, hidden=24, patch_width=8, reach=4, groups=2)),
    "wav2clip": lambda: Wav2Clip(Wav2ClipConfig(width=4, blocks=1)),
}
BOOK = torch.randn(3, 2, 8, 4, generator=torch.Generator().manual_seed(0))


def encoder(kind: str, *, is_frozen: bool = True) -> AudioMotion:
    torch.manual_seed(0)
    codec = AudioCodec(CODEC)
    torch.nn.init.normal_(codec.codebooks)
    sizes = {"width": 16, "layers": 1, "heads": 2, "size": 120}
    return AudioMotion.from_network(NETWORKS[kind](), codec, BOOK, is_frozen=is_frozen, **sizes)


@pytest.mark.parametrize("kind", ["beats", "wav2clip"])
def test_codes_are_embedded_like_the_waveform_that_the_codec_decodes(kind, tmp_path):
    model = encoder(kind).eval()
    assert isinstance(model.audio_encoder, WaveformEncoder)
    codes = torch.randint(16, (2, 300, 2), generator=torch.Generator().manual_seed(1))
    heard, wave = model.embed_audio(codes), decoded_waveform(model.audio_encoder.codec, codes)
    assert wave.shape == (2, 64_000)
    assert heard.shape == (2, 120)
    torch.testing.assert_close(model.embed_audio(wave), heard)
    assert (model.embed_audio(codes.flip(1)) - heard).abs().max() > 1e-4
    model.save(tmp_path, {})
    again = AudioMotion.load(tmp_path)
    assert again.config.audio_encoder.kind == kind
    torch.testing.assert_close(again.embed_audio(codes), heard)


@pytest.mark.parametrize("kind", ["beats", "wav2clip"])
def test_published_weights_stay_as_they_are_and_small_ones_learn(kind):
    wave = 0.1 * torch.randn(4, 16_000, generator=torch.Generator().manual_seed(1))
    for is_frozen in (True, False):
        model = encoder(kind, is_frozen=is_frozen).train()
        before = {name: value.clone() for name, value in model.audio_encoder.network.state_dict().items()}
        optimiser = torch.optim.SGD([p for p in model.parameters() if p.requires_grad], lr=1.0)
        model.embed_audio(wave).square().sum(1).mean().backward()
        (model.embed_audio(wave)[:, :3].sum()).backward()
        optimiser.step()
        after = model.audio_encoder.network.state_dict()
        assert all(torch.equal(value, after[name]) for name, value in before.items()) == is_frozen
        assert model.audio_encoder.out.weight.grad is not None
        assert all(p.grad is None for p in model.audio_encoder.codec.parameters())


def test_resampling_keeps_a_tone(tiny_bundle):
    """440 Hz stays 440 Hz, 10 kHz is gone; the codec is replaced by one that returns a given waveform."""
    rate, seconds = 24_000, 1
    at = torch.arange(rate * seconds, dtype=torch.float64) / rate
    sound = (0.5 * torch.sin(2 * math.pi * 440 * at) + 0.5 * torch.sin(2 * math.pi * 10_000 * at))[None]

    class Plays(AudioCodec):
        def __init__(self):
            torch.nn.Module.__init__(self)

        def decode(self, codes):
            return sound

    found = decoded_waveform(Plays(), torch.zeros(1, 75, 2, dtype=torch.int64))
    wanted = 0.5 * torch.sin(2 * math.pi * 440 * torch.arange(16_000, dtype=torch.float64) / 16_000)
    torch.testing.assert_close(found[0].double(), wanted, atol=1e-5, rtol=0)
    assert load_bundle(tiny_bundle).codec.decode(torch.zeros(1, 75, 2, dtype=torch.int64)).shape == (1, 24_000)


def test_configs_that_contradict_themselves_are_refused():
    with pytest.raises(ValidationError, match="need a codec"):
        AudioEncoderConfig(beats=BeatsConfig())
    with pytest.raises(ValidationError, match="not both"):
        AudioEncoderConfig(beats=BeatsConfig(), wav2clip=Wav2ClipConfig(), codec=CODEC)


def test_sinusoids_by_hand():
    """Position 1 of width 4: sin 1, cos 1, sin 0.01, cos 0.01."""
    one = torch.tensor(1.0)
    wanted = torch.stack([one.sin(), one.cos(), (one / 100).sin(), (one / 100).cos()])
    torch.testing.assert_close(sinusoids(2, 4)[1], wanted)
