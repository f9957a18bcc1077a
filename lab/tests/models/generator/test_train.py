"""Training learns what audio says, and resumes to the same curve."""

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from tests.models.generator.tiny import LAYOUT, config, generator
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.generator.losses import nll_by_domain
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import build_sequences
from echoavatar_lab.models.generator.train import GeneratorTask, GeneratorTraining, align_embeddings
from echoavatar_lab.models.generator.windows import TokenClip, WindowSampler
from echoavatar_lab.training import train


def test_the_default_is_stage_two_and_unknown_choices_are_refused():
    training = GeneratorTraining()
    assert (training.objective, training.exemplar, training.corruption) == ("motion", 0.0, "hierarchical")
    assert training.rate_at(0) == pytest.approx(training.learning_rate / 100)
    assert training.rate_at(3000) == pytest.approx(0.05 * training.learning_rate)
    with pytest.raises(ValidationError, match="objective"):
        GeneratorTraining(objective="stage 4")
    with pytest.raises(ValidationError, match="learning"):
        GeneratorTraining(learning=1)


def test_distances_between_embeddings_are_those_between_code_vectors():
    model, books = generator(), torch.randn(3, 2, 8, 5, generator=torch.Generator().manual_seed(0))
    align_embeddings(model, motion_codebooks=books)
    for segment in (0, 5):
        rows = model.model.embed_tokens.weight[LAYOUT.segment_start(segment) :][:8].detach()
        vectors = books.flatten(0, 1)[segment]
        ratio = torch.pdist(rows) / torch.pdist(vectors)
        torch.testing.assert_close(ratio, ratio.mean().expand_as(ratio))


def test_aligned_rows_have_the_scale_of_the_others_and_no_other_row_changes():
    model = generator()
    before = model.model.embed_tokens.weight.detach().clone()
    align_embeddings(model, audio_codebooks=torch.randn(2, 16, 40))
    after = model.model.embed_tokens.weight.detach()
    audio_rows = after[LAYOUT.audio_base : LAYOUT.motion_base]
    assert 0.015 < float(audio_rows.std()) < 0.025
    assert torch.equal(before[LAYOUT.motion_base :], after[LAYOUT.motion_base :])
    assert torch.equal(before[: LAYOUT.audio_base], after[: LAYOUT.audio_base])


def clips(count=4, chunks=12):
    """Motion that follows the audio of its chunk: every code is the first audio code of the chunk, modulo 8."""
    rng = np.random.default_rng(0)
    made = []
    for _ in range(count):
        key = rng.integers(16, size=chunks)
        audio = np.repeat(key, 20)[:, None].repeat(2, 1)
        motion = np.repeat(key % 8, 2)[:, None, None] * np.ones((1, 3, 2), int)
        made.append(TokenClip(audio, motion, np.full(2 * chunks, 1, np.uint8)))
    return made


def settings(**changes):
    usual = {"steps": 6, "batch": 2, "chunks": 4, "warmup": 2, "depth_weights": (1.0, 0.5), "save_every": 3}
    return GeneratorTraining(**(usual | changes))


@pytest.mark.parametrize(
    ("sequence", "optimiser", "at"),
    [("interleaved", "adamw", 1), ("interleaved", "muon", 5), ("prefix", "adamw", 4), ("depth", "muon", 2)],
)
def test_a_run_that_was_killed_resumes_to_the_same_curve(tmp_path, sequence, optimiser, at):
    """Killed after some step of 6, with its last checkpoint at step 3 or none: what was lost is repeated to the bit."""
    training = settings(optimiser=optimiser, cue_weight=0.1, out_of_step=0.5, average=0.5)
    check_resume(
        lambda folder, **how: (
            train(GeneratorTask(config(sequence=sequence), training, clips()), folder, **how).generator
        ),
        tmp_path,
        at=at,
    )


@pytest.mark.parametrize(("sequence", "asked"), [("interleaved", 1.0), ("prefix", 1.0), ("depth", 1.0), ("depth", 0.4)])
def test_pieces_share_one_trajectory(sequence, asked):
    """Eight windows at once or one after the other (1x8 and 8x1), some of them cut short in the prefix order."""

    def make(pieces):
        training = settings(batch=8, accumulation=pieces, exemplar=0.5, blind=0.2, short_windows=0.5, asked=asked)
        return GeneratorTask(config(sequence=sequence, exemplar=True), training, clips())

    check_pieces(make, 8, "gradient", steps=6)


def test_clips_of_split_test_measure_and_do_not_teach():
    ours = [*clips(2), *(clip.__class__(clip.audio, clip.motion, clip.domain, "test") for clip in clips(4)[2:])]
    stage = GeneratorTask(config(), settings(), ours)
    assert len(stage.sampler) == 2 * 9
    measured = stage.evaluate()
    assert measured.keys() == {"held_out", "held_out_speech"}
    assert 1.5 < measured["held_out"] < 2.5  # near ln 8
    assert GeneratorTask(config(), settings(), ours[:2]).evaluate() == {}


def test_training_learns_to_follow_the_audio(tmp_path):
    """Uniform guessing costs ln 8 = 2.08 nats. With another clip's audio the first code of each chunk is a surprise,
    and the 11 others contradict the audio."""
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5)
    model = train(GeneratorTask(config(layers=1), training, clips(16)), tmp_path).generator
    held = clips(20)[16:]
    true, shuffled = nll_by_domain(model, held), nll_by_domain(model, held, shuffled_audio=True)
    assert true["speech"] < 1.0
    assert shuffled["speech"] > true["speech"] + 0.4


def lesson(**changes):
    """The first step's windows, the sequences made of them, and the stage that makes them."""
    stage = GeneratorTask(config(), settings(**changes), clips())
    drawn = stage.draw(0)
    window = WindowSampler(clips(), chunks=4).batch(0, 2)
    assert torch.equal(window.motion, drawn.window.motion)
    order = stage.generator.config.order
    return window, build_sequences(order, window.audio, drawn.context, window.motion, drawn.missing), stage


def clean_sequences(window, stage):
    order = stage.generator.config.order
    return build_sequences(order, window.audio, window.motion, window.motion, torch.zeros(2).long())


def test_targets_stay_clean_and_context_is_corrupted():
    window, damaged, stage = lesson(corruption_low=1.0, corruption_high=1.0)
    clean = build_sequences(
        stage.generator.config.order, window.audio, window.motion, window.motion, torch.zeros(2).long()
    )
    assert torch.equal(damaged.targets, clean.targets)
    assert 0.3 < (damaged.ids != clean.ids).float().sum() / (2 * 8 * 6) < 0.9


def test_a_blind_window_has_noise_for_context_and_clean_targets():
    window, made, stage = lesson(corruption="none", blind=1.0)
    clean = build_sequences(
        stage.generator.config.order, window.audio, window.motion, window.motion, torch.zeros(2).long()
    )
    assert torch.equal(made.targets, clean.targets)
    assert (made.ids != clean.ids).sum() > 0.75 * 2 * 8 * 6  # 7 of 8 random codes differ


def test_a_window_out_of_step_drifts_and_its_targets_keep_time():
    taught = settings(corruption="none", out_of_step=0.5, batch=64, chunks=12)
    stage = GeneratorTask(config(window_chunks=12), taught, clips())
    late = set()
    for step in range(4):
        lesson = stage.draw(step)
        true, told = lesson.window.motion[:, 1:-1, 0, 0], lesson.context[:, 1:-1, 0, 0]
        is_in_step = (true == told).all(1)
        assert 16 < is_in_step.sum() < 48
        for row in range(64):
            for by in range(-3, 4):  # clips hold a code for two tokens, so neighbours fit too
                if torch.equal(lesson.context[row, 6:10], lesson.window.motion[row, 6 - by : 10 - by]):
                    late.add(by)
    assert late == set(range(-3, 4))


def test_a_window_with_anothers_past_has_its_own_targets_and_its_own_context_from_a_token_on():
    window, made, stage = lesson(corruption="none", other_past=1.0)
    order, none = stage.generator.config.order, torch.zeros(2).long()
    assert torch.equal(made.targets, build_sequences(order, window.audio, window.motion, window.motion, none).targets)
    context, tokens = stage.draw(0).context, torch.arange(window.motion.shape[1])
    for row in range(2):
        mixed = [
            torch.where((tokens < until)[:, None, None], window.motion[1 - row], window.motion[row])
            for until in tokens + 1
        ]
        assert any(torch.equal(context[row], each) for each in mixed)


@pytest.mark.slow
def test_cues_are_learned_from_the_sound(tmp_path):
    """Every clip beats where its audio code is below 4: known cues make that readable in the hidden state."""
    made = [TokenClip(c.audio, c.motion, c.domain, cues=(c.audio < 4).astype(np.uint8)) for c in clips(8)]
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5, cue_weight=1.0)
    train(GeneratorTask(config(layers=1), training, made), tmp_path)
    rows = list(losses(tmp_path, "cues").values())
    assert np.mean(rows[-5:]) < 0.3 * np.mean(rows[:5])


def test_other_settings_or_another_model_are_not_resumed(tmp_path):
    train(GeneratorTask(config(), settings(steps=1), clips()), tmp_path)
    with pytest.raises(CheckpointError, match="another training config: steps was 1, is 2"):
        train(GeneratorTask(config(), settings(steps=2), clips()), tmp_path)
    with pytest.raises(CheckpointError, match="another generator config: mlp"):
        train(GeneratorTask(config(mlp=56), settings(steps=1), clips()), tmp_path)
    with pytest.raises(CheckpointError, match="depth_weights"):
        GeneratorTask(config(), settings(depth_weights=(1.0,)), clips())


def test_a_finished_model_is_a_start_for_a_new_run(tmp_path):
    old = generator(seed=3)
    old.save(tmp_path / "old", {"kind": "generator"})
    still = settings(steps=1, learning_rate=1e-12)
    start = Generator.load(tmp_path / "old")
    new = train(GeneratorTask(config(), still, clips()), tmp_path / "new", start=start).generator
    for key, value in old.state_dict().items():
        torch.testing.assert_close(new.state_dict()[key], value, atol=1e-6, rtol=1e-5)


def test_in_stage_one_only_the_embeddings_learn_and_the_streams_get_likelier(tmp_path):
    """Codes that repeat for a chunk are foretold from themselves: likelihoods rise with a body that stays random."""
    training = settings(steps=40, batch=8, objective="streams", learning_rate=2e-2, warmup=2, cue_weight=0.3)
    stage = GeneratorTask(config(layers=1), training, clips(16))
    before = {key: value.clone() for key, value in stage.generator.state_dict().items()}
    model = train(GeneratorTask(config(layers=1), training, clips(16)), tmp_path).generator
    changed = {key for key, value in model.state_dict().items() if not torch.equal(value, before[key])}
    assert changed == {"model.embed_tokens.weight", "lm_head.weight"}
    for key in ("nll_audio", "nll_motion"):
        curve = list(losses(tmp_path, key).values())
        assert curve[-1] < 0.6 * curve[0]


@pytest.mark.slow
def test_only_a_generator_that_hears_ahead_foretells_what_a_later_sound_decides(tmp_path):
    """Each chunk moves to the next chunk's audio code: its first code is guesswork live, known one chunk ahead."""
    made = [TokenClip(c.audio[:-20], c.motion[2:], c.domain[2:]) for c in clips(20, 13)]
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5)
    heard = {}
    for ahead in (0, 1):
        shape = config(layers=1, ahead_chunks=ahead)
        model = train(GeneratorTask(shape, training, made[:16]), tmp_path / str(ahead)).generator
        heard[ahead] = nll_by_domain(model, made[16:])["speech"]
    assert heard[1] < heard[0] - 0.1
