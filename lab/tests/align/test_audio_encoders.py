"""Filter banks: Kaldi's own numbers, and how many frames there are."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from pydantic import ValidationError

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import CheckpointError
from echoavatar.models.audio import CodecConfig
from echoavatar_lab.align.audio_encoders import (
    FBANK_MEAN,
    FBANK_STD,
    QUIET,
    AudioEncoderConfig,
    Beats,
    BeatsConfig,
    GatedAttention,
    PositionConv,
    Wav2Clip,
    Wav2ClipConfig,
    WaveformEncoder,
    _relative_buckets,
    decoded_waveform,
    fbank,
    sinusoids,
    spectrogram,
)
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.decoding import decode

KALDI = {
    (0, 0): 14.94371509552002,
    (0, 20): 18.58997344970703,
    (3, 40): 6.724812984466553,
    (10, 64): 3.9602608680725098,
    (22, 100): 4.747962474822998,
}
"""kaldi-native-fbank 1.22.3 (128 bins, Povey window, no dither) of the sound below, by frame and band."""


def sound() -> torch.Tensor:
    n = np.arange(4000)
    wave = 0.3 * np.sin(2 * np.pi * 440 * n / 16000) + 0.1 * np.sin(2 * np.pi * 3000 * n / 16000 + 1)
    return torch.from_numpy(wave + 0.05 * np.sin(n * n / 9000))[None]


def test_bands_are_kaldis():
    found = fbank(sound())[0] * 2 * FBANK_STD + FBANK_MEAN
    for place, wanted in KALDI.items():
        assert found[place].item() == pytest.approx(wanted, abs=1e-3)


def test_only_whole_frames_count():
    lengths = {400: 1, 559: 1, 560: 2, 64_000: 398}
    assert {samples: fbank(torch.zeros(1, samples)).shape[1] for samples in lengths} == lengths


def test_silence_is_the_floor():
    floor = (math.log(torch.finfo(torch.float32).eps) - FBANK_MEAN) / (2 * FBANK_STD)
    torch.testing.assert_close(fbank(torch.zeros(1, 800)), torch.full((1, 3, 128), floor))


SMALL = BeatsConfig(layers=2, width=24, heads=3, hidden=40, patch_width=10, buckets=16, farthest=800, reach=6, groups=4)


def small_beats() -> Beats:
    torch.manual_seed(0)
    return Beats(SMALL).eval()


def beats_as_published(model: Beats) -> dict[str, torch.Tensor]:
    """As in the published file: every layer has the one table, and there is a classifier."""
    table = "self_attn.relative_attention_bias.weight"
    state = dict(model.state_dict())
    state |= {f"encoder.layers.1.{table}": state[f"encoder.layers.0.{table}"]}
    return state | {"predictor.weight": torch.zeros(5, 24), "predictor.bias": torch.zeros(5)}


def test_published_weights_of_beats_load_and_their_sizes_are_read_off():
    one, wave = small_beats(), 0.1 * torch.randn(2, 16_000)
    again = Beats.from_published(beats_as_published(one))
    assert again.config == SMALL
    torch.testing.assert_close(again(wave), one(wave))


def test_names_of_beats_are_the_published_ones():
    names = set(small_beats().state_dict())
    assert {
        "patch_embedding.weight",
        "layer_norm.weight",
        "post_extract_proj.bias",
        "encoder.pos_conv.0.weight_g",
        "encoder.pos_conv.0.weight_v",
        "encoder.layer_norm.weight",
        "encoder.layers.0.self_attn.relative_attention_bias.weight",
        "encoder.layers.1.self_attn.grep_linear.weight",
        "encoder.layers.1.self_attn.grep_a",
        "encoder.layers.1.self_attn_layer_norm.weight",
        "encoder.layers.1.fc2.bias",
        "encoder.layers.1.final_layer_norm.bias",
    } <= names
    assert "encoder.layers.1.self_attn.relative_attention_bias.weight" not in names


def test_a_state_every_160_ms():
    """4 s: 398 frames, 24 whole patches in time, 8 in frequency."""
    model, wave = small_beats(), torch.zeros(1, 64_000)
    assert model(wave).shape == (1, 24, 24)
    assert model.patches(wave).shape == (1, 24 * 8, 24)


def test_other_weights_than_beats_are_refused():
    with pytest.raises(CheckpointError, match="these are not BEATs weights"):
        Beats.from_published({"encoder.weight": torch.zeros(2)})
    short = beats_as_published(small_beats())
    del short["encoder.layers.1.fc1.weight"]
    with pytest.raises(CheckpointError, match="these are not BEATs weights"):
        Beats.from_published(short)


def test_distances_are_exact_up_close_and_grow_far_off():
    """16 buckets: 8 behind, 8 ahead; 0 to 3 exact, then by the logarithm, the last from 800 on."""
    near = _relative_buckets(2000, 16, 800)
    assert near[5, :9].tolist() == [4, 4, 3, 2, 1, 0, 9, 10, 11]
    assert near[0, 1999] == 15
    assert near[1999, 0] == 7
    assert (near[1000, :1001].diff() <= 0).all()


def test_attention_by_hand():
    """Softmax of q k / sqrt(d) + gate x bias, the gate of each query between 0 and 3."""
    torch.manual_seed(1)
    one = GatedAttention(SMALL)
    torch.nn.init.normal_(one.grep_a)
    x, bias = torch.randn(1, 5, 24), torch.randn(3, 5, 5)
    heads = []
    for h in range(3):
        rows = slice(8 * h, 8 * h + 8)
        q, k, v = (F.linear(x[0], part.weight[rows], part.bias[rows]) for part in (one.q_proj, one.k_proj, one.v_proj))
        raw = F.linear(q, one.grep_linear.weight, one.grep_linear.bias)
        a, b = torch.sigmoid(raw[:, :4].sum(1)), torch.sigmoid(raw[:, 4:].sum(1))
        gate = a * (b * one.grep_a[0, h, 0, 0] - 1) + 2
        heads.append(torch.softmax(q @ k.T / 8**0.5 + gate[:, None] * bias[h], -1) @ v)
    wanted = F.linear(torch.cat(heads, 1), one.out_proj.weight, one.out_proj.bias)
    torch.testing.assert_close(one(x, bias)[0], wanted)


def test_positions_are_a_weight_normed_convolution():
    torch.manual_seed(2)
    one, x = PositionConv(SMALL), torch.randn(2, 9, 24)
    conv = torch.nn.utils.parametrizations.weight_norm(torch.nn.Conv1d(24, 24, 6, padding=3, groups=4), dim=2)
    with torch.no_grad():
        conv.parametrizations.weight.original0.copy_(2 * one.weight_g)
        conv.parametrizations.weight.original1.copy_(one.weight_v)
        conv.bias.copy_(torch.randn(24))
        one.bias.copy_(conv.bias)
        one.weight_g.mul_(2)
    wanted = F.gelu(conv(x.transpose(1, 2))[..., :-1]).transpose(1, 2)
    torch.testing.assert_close(one(x), wanted)


def small_wav2clip() -> Wav2Clip:
    torch.manual_seed(0)
    return Wav2Clip(Wav2ClipConfig(width=4)).eval()


def wav2clip_as_published(model: Wav2Clip) -> dict[str, torch.Tensor]:
    """As in the published file: with the spectrogram's window, a classifier and the projection to CLIP's space."""
    state = {f"audio_encoder.{name}": value for name, value in model.state_dict().items()}
    extras = ("audio_encoder.spectrogram.window", "audio_encoder.fc.weight", "audio_transform.sequential.0.weight")
    return state | {name: torch.zeros(2) for name in extras}


def test_published_weights_of_wav2clip_load_and_their_sizes_are_read_off():
    one, wave = small_wav2clip(), 0.1 * torch.randn(2, 16_000)
    again = Wav2Clip.from_published(wav2clip_as_published(one))
    assert again.config == Wav2ClipConfig(width=4, blocks=2)
    torch.testing.assert_close(again(wave), one(wave))


def test_names_of_wav2clip_are_the_published_ones():
    names = set(small_wav2clip().state_dict())
    assert {
        "conv1.weight",
        "bn1.running_var",
        "layer1.0.conv1.weight",
        "layer1.1.bn2.bias",
        "layer2.0.downsample.0.weight",
        "layer2.0.downsample.1.running_mean",
        "layer4.1.conv2.weight",
    } <= names
    assert not any("layer1.0.downsample" in name for name in names)


def test_sizes_of_wav2clip_are_the_published_ones():
    """ResNet-18 without its classifier, one channel in: 11.17 million weights."""
    model = Wav2Clip(Wav2ClipConfig())
    assert model.width == 512
    assert sum(p.numel() for p in model.parameters()) == 11_170_240


def test_the_spectrogram_by_hand():
    """A tone of bin 32: its frame by the definition of the transform, before the clip's mean and deviation."""
    wave = torch.sin(2 * math.pi * 32 * torch.arange(16_000) / 512)[None]
    found = spectrogram(wave)
    assert found.shape == (1, 257, 1 + 16_000 // 353)
    assert found.mean().item() == pytest.approx(0, abs=1e-4)
    assert found.std().item() == pytest.approx(1, abs=1e-3)
    frame = wave[0, 20 * 353 - 256 : 20 * 353 + 256] * torch.hann_window(512)
    powers = torch.tensor(
        [(frame * torch.exp(-2j * math.pi * k * torch.arange(512) / 512)).sum().abs().item() ** 2 for k in range(257)]
    )
    logs = (powers + QUIET).log()
    rise = found[0, 32, 20] - found[0, 34, 20], logs[32] - logs[34]
    fall = found[0, 33, 20] - found[0, 34, 20], logs[33] - logs[34]
    assert (rise[0] / fall[0]).item() == pytest.approx((rise[1] / fall[1]).item(), rel=1e-2)


def test_states_do_not_depend_on_the_batch():
    one, wave = small_wav2clip(), torch.randn(3, 8_000) * torch.tensor([[0.01], [0.1], [1.0]])
    torch.testing.assert_close(one(wave)[:1], one(wave[:1]), rtol=1e-4, atol=1e-5)


def test_other_weights_than_wav2clips_are_refused():
    with pytest.raises(CheckpointError, match="these are not Wav2CLIP weights"):
        Wav2Clip.from_published({"audio_encoder.weight": torch.zeros(2)})
    short = wav2clip_as_published(small_wav2clip())
    del short["audio_encoder.layer3.0.conv2.weight"]
    with pytest.raises(CheckpointError, match="these are not Wav2CLIP weights"):
        Wav2Clip.from_published(short)


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
    assert getattr(again.config.audio_encoder, kind) is not None
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


def test_resampling_keeps_a_tone(tiny_bundle, monkeypatch):
    """440 Hz stays 440 Hz, 10 kHz is gone; decoding is replaced by a given waveform."""
    rate, seconds = 24_000, 1
    at = torch.arange(rate * seconds, dtype=torch.float64) / rate
    sound = (0.5 * torch.sin(2 * math.pi * 440 * at) + 0.5 * torch.sin(2 * math.pi * 10_000 * at))[None]

    codec, codes = load_bundle(tiny_bundle).codec, torch.zeros(1, 75, 2, dtype=torch.int64)
    assert decode(codec, codes).shape == (1, 24_000)
    monkeypatch.setattr("echoavatar_lab.align.audio_encoders.decode", lambda *_: sound)
    found = decoded_waveform(codec, codes)
    wanted = 0.5 * torch.sin(2 * math.pi * 440 * torch.arange(16_000, dtype=torch.float64) / 16_000)
    torch.testing.assert_close(found[0].double(), wanted, atol=1e-5, rtol=0)


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
