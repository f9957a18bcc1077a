"""Wav2CLIP's network: the spectrogram by hand, the names of its published weights, and what is no such file."""

import math

import pytest
import torch

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.wav2clip import QUIET, Wav2Clip, Wav2ClipConfig, spectrogram


def small() -> Wav2Clip:
    torch.manual_seed(0)
    return Wav2Clip(Wav2ClipConfig(width=4)).eval()


def as_published(model: Wav2Clip) -> dict[str, torch.Tensor]:
    """As in the published file: with the spectrogram's window, a classifier and the projection to CLIP's space."""
    state = {f"audio_encoder.{name}": value for name, value in model.state_dict().items()}
    extras = ("audio_encoder.spectrogram.window", "audio_encoder.fc.weight", "audio_transform.sequential.0.weight")
    return state | {name: torch.zeros(2) for name in extras}


def test_published_weights_load_and_their_sizes_are_read_off():
    one, wave = small(), 0.1 * torch.randn(2, 16_000)
    again = Wav2Clip.from_published(as_published(one))
    assert again.config == Wav2ClipConfig(width=4, blocks=2)
    torch.testing.assert_close(again(wave), one(wave))


def test_names_are_the_published_ones():
    names = set(small().state_dict())
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


def test_sizes_are_the_published_ones():
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
    one, wave = small(), torch.randn(3, 8_000) * torch.tensor([[0.01], [0.1], [1.0]])
    torch.testing.assert_close(one(wave)[:1], one(wave[:1]), rtol=1e-4, atol=1e-5)


def test_other_weights_are_refused():
    with pytest.raises(CheckpointError, match="these are not Wav2CLIP weights"):
        Wav2Clip.from_published({"audio_encoder.weight": torch.zeros(2)})
    short = as_published(small())
    del short["audio_encoder.layer3.0.conv2.weight"]
    with pytest.raises(CheckpointError, match="these are not Wav2CLIP weights"):
        Wav2Clip.from_published(short)
