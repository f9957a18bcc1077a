import numpy as np
import pytest
import torch
from tests.models.face.tiny import EAR, sound

from echoavatar.models.face import HubertConfig
from echoavatar.timing import CHUNK_SAMPLES, SAMPLES_PER_FRAME
from echoavatar_lab.models.face.encoder import HubertEncoder, MelEncoder, normalize_window, pad_window


def make(chunk: int = 8, **changes: object) -> MelEncoder:
    torch.manual_seed(0)
    return MelEncoder(EAR.model_copy(update=changes), chunk).double().eval()


def seen_by(encoder: MelEncoder, frame: int) -> list[int]:
    """Which frames of sound a feature depends on."""
    audio = sound(1, 3 * CHUNK_SAMPLES, torch.Generator().manual_seed(0)).requires_grad_()
    encoder(audio)[0, frame].square().sum().backward()
    touched = audio.grad[0].unflatten(0, (-1, SAMPLES_PER_FRAME)).abs().sum(1)
    return touched.nonzero().flatten().tolist()


def test_a_frame_hears_its_own_chunk_and_a_bounded_past():
    """Two kernels reach 3 frames back each, a window starts 3 hops (1.5 frames) earlier; ahead to the chunk's end."""
    assert seen_by(make(), 16) == list(range(8, 24))
    assert seen_by(make(), 23)[-1] == 23
    assert seen_by(make(chunk=4, ahead=3), 16) == list(range(8, 20))


def test_without_looking_ahead_no_frame_hears_the_next():
    assert seen_by(make(ahead=0), 17) == list(range(9, 18))


@torch.no_grad()
def test_log_mel_is_that_of_a_plain_loop():
    encoder = make()
    audio = sound(1, CHUNK_SAMPLES, torch.Generator().manual_seed(1))
    padded = np.concatenate([np.zeros(1200), audio[0].numpy()])
    window = torch.hann_window(1600, dtype=torch.float64).numpy()
    spectra = [np.abs(np.fft.rfft(padded[i : i + 1600] * window)) / 800 for i in range(0, 6400, 400)]
    wanted = (np.log(np.array(spectra) @ encoder.bands.numpy() + 1e-4) + 6.5) / 2.5
    known = torch.nn.functional.pad(audio, (1200, 0))
    np.testing.assert_allclose(encoder.log_mel(known)[0].numpy(), wanted, atol=1e-6)


def test_pieces_that_are_no_chunks_are_refused():
    encoder = make()
    with pytest.raises(ValueError, match="6400"):
        encoder(torch.zeros(1, 6401).double())


HUBERT = HubertConfig(width=16, layers=1, heads=2, mlp=16, convolutions=(4,) * 7, position_kernel=4, position_groups=2)


@torch.no_grad()
def test_every_chunk_hears_63_frames_and_idle_rows_keep_theirs():
    torch.manual_seed(0)
    encoder = HubertEncoder(HUBERT).eval()
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
