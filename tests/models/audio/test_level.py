import pytest
import torch

from echoavatar.models.audio import LevelControl

LEVEL = LevelControl()


def decibels(x: torch.Tensor) -> float:
    return float(20 * torch.log10(x.double().square().mean().sqrt() + 1e-12))


def talk(rows: int, seconds: float, level_db: float, generator: torch.Generator) -> torch.Tensor:
    """Noise in syllables: 150 ms of sound, 100 ms of pause 40 dB lower."""
    samples = round(seconds * 24_000) // 160 * 160
    noise = torch.randn(rows, samples, generator=generator)
    envelope = torch.where(torch.arange(samples) % 6_000 < 3_600, 1.0, 0.01)
    x = noise * envelope
    return x / x.square().mean(1, keepdim=True).sqrt() * 10 ** (level_db / 20)


@pytest.mark.parametrize("size", [160, 320, 800, 6_400, 7_200])
def test_any_chunking_gives_the_same_bits(size):
    generator = torch.Generator().manual_seed(1)
    loud, soft = talk(2, 0.6, -15, generator), talk(2, 0.6, -45, generator)
    x = torch.cat([soft, loud, torch.zeros(2, 9_600), soft], 1)
    x = x[:, : x.shape[1] // size * size]
    state, active = LEVEL.init_state(2), torch.ones(2, dtype=torch.bool)
    assert torch.equal(torch.cat([LEVEL.step(part, state, active) for part in x.split(size, 1)], 1), LEVEL(x))


@pytest.mark.parametrize("level_db", [-50, -40, -23, -10])
def test_speech_of_any_level_comes_out_near_the_target(level_db):
    x = talk(1, 8, level_db, torch.Generator().manual_seed(2))
    assert -25 < decibels(LEVEL(x)) < -19
    assert -27 < decibels(LEVEL(x)[:, : 24_000 // 2]) < -15, "half a second is enough to find it"


def test_silence_is_not_turned_into_noise():
    noise = torch.randn(1, 240_000, generator=torch.Generator().manual_seed(3))
    assert torch.equal(LEVEL(torch.zeros(1, 24_000)), torch.zeros(1, 24_000))
    for level_db in (-75, -55, -45):
        assert decibels(LEVEL(noise * 10 ** (level_db / 20))) < level_db - 10


def test_noise_between_quiet_sentences_is_held_down():
    """Speech at -50 dBFS is lifted by 27 dB, the noise (-80) of the pauses by 9 once the gate has closed."""
    generator = torch.Generator().manual_seed(4)
    pause = torch.randn(1, 48_000, generator=generator) * 1e-4
    out = LEVEL(torch.cat([talk(1, 3, -50, generator), pause], 1))
    assert decibels(out[:, -24_000:]) < -65


def test_full_scale_clipping_stays_in_range():
    x = (20 * torch.randn(1, 48_000, generator=torch.Generator().manual_seed(5))).clamp(-1, 1)
    assert LEVEL(x).abs().max() < 1
    burst = torch.cat([talk(1, 3, -50, torch.Generator().manual_seed(6)), x], 1)
    assert LEVEL(burst).abs().max() < 1


def test_dynamics_of_music_survive():
    """A passage 10 dB softer for 4 s comes out at least 7 dB softer."""
    noise = torch.randn(1, 96_000, generator=torch.Generator().manual_seed(7))
    out = LEVEL(torch.cat([noise * 0.1, noise * 0.0316], 1))
    assert decibels(out[:, :96_000]) - decibels(out[:, 96_000:]) > 7


def test_gain_never_jumps():
    """A constant input shows the gain itself: no step between samples over 1 % of its range."""
    x = torch.ones(1, 48_000) * 0.002
    x[:, 24_000:] = 0.2
    gain = LEVEL(x)[0] / x[0]
    assert (gain[1:] - gain[:-1]).abs().max() < 0.01 * gain.max()


def test_any_length_is_served_offline_and_whole_blocks_live():
    assert LEVEL(torch.zeros(1, 1_001)).shape == (1, 1_001)
    assert LEVEL(torch.zeros(1, 0)).shape == (1, 0)
    with pytest.raises(ValueError, match="multiple of 160 samples, got 100"):
        LEVEL.step(torch.zeros(1, 100), LEVEL.init_state(1), torch.ones(1, dtype=torch.bool))


def noise(seconds: float, level_db: float, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(1, round(seconds * 24_000), generator=generator) * 10 ** (level_db / 20)


def test_a_soft_passage_is_loud_again_after_twenty_seconds():
    """15 dB softer than the second before it."""
    out = LEVEL(torch.cat([noise(1, -20, 8), noise(20, -35, 9)], 1))
    assert decibels(out[:, 24_000:48_000]) < -33
    assert -24 < decibels(out[:, -24_000:]) < -19


def test_a_fan_that_is_switched_on_is_sound_for_ten_seconds_and_noise_from_then_on():
    out = LEVEL(torch.cat([noise(1, -80, 10), noise(14, -50, 11)], 1))
    assert -24 < decibels(out[:, 7 * 24_000 : 8 * 24_000]) < -18
    assert decibels(out[:, 12 * 24_000 :]) < -35


def test_what_can_hardly_be_heard_is_not_lifted_and_what_surely_is_sound_is():
    """Whispers at -66 dBFS, a steady tone at -36, and speech at -45 over noise of -65."""
    assert decibels(LEVEL(talk(1, 4, -66, torch.Generator().manual_seed(12)))) < -64
    tone = torch.sin(torch.arange(96_000) / 24_000 * 2 * torch.pi * 300)[None] * 10 ** (-36 / 20) * 2**0.5
    assert -22 < decibels(LEVEL(tone)[:, -24_000:]) < -20
    speech = talk(1, 6, -45, torch.Generator().manual_seed(13))
    mixed = speech + noise(6, -65, 14)
    assert -24 < decibels(LEVEL(mixed)[:, 24_000:]) < -19


def test_the_gate_closes_smoothly_after_a_quarter_of_a_second():
    """The gain in a pause after speech: held for 0.25 s, 4 dB lower 0.1 s later, 18 dB lower at last."""
    words = talk(1, 3, -30, torch.Generator().manual_seed(15))[:, : 72_000 - 2_400]
    out = LEVEL(torch.cat([words, torch.full((1, 48_000), 1e-3)], 1))[0, words.shape[1] :]
    held, soon, closed = (20 * torch.log10(out[round(when * 24_000)] / out[0]) for when in (0.2, 0.35, 1.0))
    assert held.abs() < 0.1
    assert -7 < soon < -2
    assert -20 < closed < -16


def test_peaks_are_bent_softly():
    """A click on a soft tone: at 0.6 it stays, at 0.9 it is bent to 0.82."""
    tone = torch.sin(torch.arange(96_000) / 24_000 * 2 * torch.pi * 300)[None] * 0.126
    for peak, heard in ((0.6, 0.6), (0.9, 0.82)):
        tone[0, 80_000] = peak
        assert LEVEL(tone)[0, 80_000] == pytest.approx(heard, abs=0.01)
