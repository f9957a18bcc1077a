import torch

from echoavatar_lab.models.audio.loss import SpectrumProbe, sound_loss


def test_equal_sounds_have_no_distance_and_silence_is_worse_than_a_copy_with_errors():
    torch.manual_seed(0)
    sound = 0.1 * torch.randn(2, 9_600)
    assert all(float(term) == 0 for term in sound_loss(sound, sound))
    near, silent = sound_loss(sound + 0.01 * torch.randn_like(sound), sound), sound_loss(0 * sound, sound)
    assert all(float(a) < float(b) for a, b in zip(near, silent, strict=True))


def test_gradients_stay_finite_at_silence():
    made = torch.zeros(1, 6_400, requires_grad=True)
    sum(sound_loss(made, torch.zeros(1, 6_400))).backward()
    assert made.grad is not None
    assert made.grad.isfinite().all()


def test_probe_predicts_four_mel_frames_per_latent():
    probe = SpectrumProbe(width=8)
    assert probe(torch.randn(2, 15, 8)).shape == probe.target(torch.randn(2, 15 * 320)).shape == (2, 60, 64)
