import pytest
import torch

from echoavatar.errors import CheckpointError
from echoavatar.models.face import HubertConfig
from echoavatar.models.face.hubert import HubertEncoder, normalize_window, pad_window
from echoavatar.timing import CHUNK_SAMPLES

EAR = HubertConfig(width=16, layers=1, heads=2, mlp=16, convolutions=(4,) * 7, position_kernel=4, position_groups=2)


@torch.no_grad()
def test_every_chunk_hears_63_frames_and_idle_rows_keep_theirs():
    torch.manual_seed(0)
    encoder = HubertEncoder(EAR).eval()
    audio = torch.randn(2, 10 * CHUNK_SAMPLES)
    state, active = encoder.init_state(2), torch.tensor([True, False])
    for part in audio[:, :-CHUNK_SAMPLES].split(CHUNK_SAMPLES, 1):
        encoder.step(part, state, active)
    features = encoder.step(audio[:, -CHUNK_SAMPLES:], state, active)
    assert features.shape == (2, 63, 16)
    assert torch.equal(state.samples[0], audio[0, -63 * 800 :])
    assert state.samples[1].abs().max() == 0
    alone = encoder.window(encoder.resample(audio[:1, -63 * 800 :]))
    torch.testing.assert_close(features[:1], alone)
    torch.testing.assert_close(encoder(audio[:1])[:, -8:], features[:1, -8:])


def test_normalised_over_the_window():
    audio = normalize_window(3 + 5 * torch.randn(2, 1000))
    assert audio.mean().abs() < 1e-5
    torch.testing.assert_close(audio.std(1), torch.ones(2), atol=1e-4, rtol=0)


def test_63_frames_need_no_padding():
    assert pad_window(torch.zeros(1, 33579)).shape[1] == 33579


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(CheckpointError, match="mel encoder"):
        HubertEncoder.from_pretrained(tmp_path / "none")
