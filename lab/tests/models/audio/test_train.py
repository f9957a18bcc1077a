import numpy as np
import pytest
import torch
from tests.models.runs import check_pieces, check_resume

from echoavatar.errors import CheckpointError
from echoavatar.models.audio import CodecConfig
from echoavatar.stored import read_card
from echoavatar_lab.models.audio.decoding import synthesize
from echoavatar_lab.models.audio.recordings import AudioGroup, AudioPool, to_int16
from echoavatar_lab.models.audio.train import (
    CodecTask,
    CodecTrainingConfig,
    SpectrumProbe,
    augment,
    make_batch,
    sound_loss,
    source_samples,
)
from echoavatar_lab.training import Loop, train


def piece(seed: int, samples: int = 24_000) -> tuple[np.random.Generator, np.ndarray, float]:
    rng = np.random.default_rng(seed)
    factor, needed = source_samples(rng, samples)
    return rng, rng.standard_normal(needed).astype(np.float32) * 0.1, factor


@pytest.mark.parametrize("seed", range(30))
def test_pairs_are_finite_whole_and_in_range(seed):
    rng, source, factor = piece(seed)
    pair = augment(rng, source, factor, 24_000)
    for sound in pair:
        assert sound.shape == (24_000,)
        assert sound.dtype == np.float32
        assert np.isfinite(sound).all()
        assert np.abs(sound).max() <= 1


def test_same_seed_same_pair_other_seed_other_pair():
    first, again, other = (augment(*piece(seed)[:2], piece(seed)[2], 24_000) for seed in (1, 1, 2))
    assert np.array_equal(first.heard, again.heard)
    assert not np.array_equal(first.heard, other.heard)


def test_the_target_is_never_noisier_than_what_is_heard():
    """Over many draws some pairs are equal, some differ, and the target follows the source's timing (no delay)."""
    differs, lags = 0, []
    for seed in range(20):
        rng, source, factor = piece(seed, 8_000)
        pair = augment(rng, source, factor, 8_000)
        differs += not np.array_equal(pair.heard, pair.target)
        spectrum = np.fft.rfft(pair.heard, 16_384) * np.conj(np.fft.rfft(pair.target, 16_384))
        lags.append(int(np.argmax(np.abs(np.fft.irfft(spectrum)[:200]))))
    assert 5 < differs <= 20
    assert max(lags) <= 2


def test_silence_stays_nearly_silent():
    rng, source, factor = piece(3)
    pair = augment(rng, np.zeros_like(source), factor, 24_000)
    assert np.abs(pair.heard).max() < 0.02
    assert np.abs(pair.target).max() < 0.02


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


CONFIG = CodecTrainingConfig(
    codec=CodecConfig(filters=2, width=8, codes=16, lstm_layers=1),
    steps=30,
    learning_rate=3e-3,
    batch=3,
    decoded=2,
    crop_frames=12,
    warmup=5,
    unquantized=5,
    save_every=10,
)


LICENCE = {"licence": "Apache-2.0"}


@pytest.fixture(scope="module")
def pool() -> AudioPool:
    rng = np.random.default_rng(0)
    time = np.arange(48_000) / 24_000
    tones = [np.sin(2 * np.pi * rng.uniform(100, 2_000) * time) * (np.sin(9 * time) > 0) * 0.2 for _ in range(4)]
    return AudioPool([AudioGroup("tones", tuple(to_int16(tone) for tone in tones))])


def test_batches_depend_on_seed_and_step_alone(pool):
    first, again, next_one = (make_batch(CONFIG, pool, step) for step in (3, 3, 4))
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[1], again[1])
    assert not torch.equal(first[0], next_one[0])


def test_training_lowers_the_losses_and_uses_the_codes(pool):
    loop = Loop(CodecTask(CONFIG, pool))
    history = [loop.advance() for _ in range(30)]
    early, late = (np.mean([line["probe"] for line in part]) for part in (history[:3], history[-5:]))
    assert late < 0.8 * early
    assert history[-1]["perplexity_0"] > 3
    assert loop.done() == 1


def test_a_resumed_run_is_the_same_run(pool, tmp_path):
    """Stopped after 24 of 30 steps and taken up again at step 20."""
    check_resume(
        lambda folder, **more: train(CodecTask(CONFIG, pool, card=LICENCE), folder, **more).codec, tmp_path, at=24
    )
    card = read_card(tmp_path / "killed")
    assert (card["steps_done"], card["sound_seconds"]) == (30, {"tones": 8.0})
    assert card.items() >= LICENCE.items()


@pytest.fixture
def double():
    """Double precision: in single precision rounding, which differs from processor to processor, may turn a code."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("double")
def test_pieces_share_one_trajectory(pool):
    """Six rows at once or two by two, of which two are decoded, before and after the codebooks begin to learn."""

    def make(pieces):
        return CodecTask(CONFIG.model_copy(update={"batch": 6, "accumulation": pieces, "unquantized": 2}), pool)

    check_pieces(make, 3, "log_mel", steps=4)


def test_a_run_of_other_sizes_is_refused(pool, tmp_path):
    train(CodecTask(CONFIG.model_copy(update={"steps": 6}), pool), tmp_path)
    other = CONFIG.model_copy(update={"codec": CodecConfig(filters=4, width=8, codes=16, lstm_layers=1)})
    with pytest.raises(CheckpointError, match="another codec config: filters was 2, is 4"):
        train(CodecTask(other, pool), tmp_path)


def test_the_clock_can_end_a_run(pool, tmp_path):
    config = CONFIG.model_copy(update={"steps": 10**9, "minutes": 1e-4})
    train(CodecTask(config, pool), tmp_path)
    assert int(read_card(tmp_path)["steps_done"]) < 50


def test_fresh_weights_answer_speech_with_unit_variance(pool):
    codec = CodecTask(CONFIG, pool).codec
    audio = 0.07 * torch.randn(4, 24_000, generator=torch.Generator().manual_seed(1))
    state = codec.init_state(4)
    with torch.no_grad():
        latents = codec.latents(audio, state, state.seen == 0)
    assert 0.7 < float(latents.std()) < 1.5
    assert 0.02 < float(synthesize(codec, latents).detach().std()) < 0.2


def test_a_run_begins_with_a_trained_codec(pool, tmp_path):
    start = train(CodecTask(CONFIG, pool), tmp_path / "a").codec
    still = CONFIG.model_copy(update={"learning_rate": 1e-12, "steps": 1})
    again, fresh = (
        train(CodecTask(still, pool), tmp_path / name, start=one).codec for name, one in (("b", start), ("c", None))
    )
    for near, is_same in ((again, True), (fresh, False)):
        assert torch.allclose(near.encoder.layers[0].conv.weight, start.encoder.layers[0].conv.weight) == is_same
        assert (torch.dist(near.codebooks, start.codebooks) < 0.3 * start.codebooks.norm()) == is_same
