"""The set steers what is sampled, off is exactly as before, and the stream does what training saw."""

import numpy as np
import pytest
import torch
from lab.tests.models.generator.test_train import clips as any_clips
from lab.tests.models.generator.test_train import settings
from tests.models.generator.tiny import audio, config, generator

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.generator.exemplar import control_ids
from echoavatar_lab.models.generator.losses import code_nll
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import Exemplar, build_sequences, code_logits, compact_layout, read
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.models.generator.windows import TokenClip, draw_exemplar
from echoavatar_lab.training import train

EVERYONE = torch.ones(2, dtype=torch.bool)


def members(*sets):
    rows = torch.zeros(len(sets), 8)
    for row, codes in zip(rows, sets, strict=True):
        row[list(codes)] = 1
    return rows


@pytest.mark.parametrize("sequence", ["interleaved", "prefix"])
def test_a_set_is_what_its_span_uses_with_a_tenth_to_a_fifth_left_out(sequence):
    random = torch.Generator().manual_seed(0)
    motion = torch.randint(500, (400, 32, 3, 2), generator=random)
    drawn = draw_exemplar(motion, 0.5, codes=500, whole=sequence == "prefix", generator=random)
    told = drawn.holds.any(1)
    assert 0.4 < told.float().mean() < 0.6
    assert not drawn.members[~told].any()
    if sequence == "prefix":
        assert bool((drawn.holds.all(1) == told).all())
    kept = used = 0
    for codes, holds, row in zip(motion[:, :, 1, 0], drawn.holds, drawn.members, strict=True):
        span = set(codes[holds].tolist())
        chosen = set(row.nonzero().flatten().tolist())
        assert chosen <= span
        starts = holds.nonzero().flatten()
        if len(starts):  # whole chunks in one piece
            assert starts[0] % 2 == 0
            assert len(starts) == starts[-1] - starts[0] + 1 >= 6
        kept, used = kept + len(chosen), used + len(span)
    assert 0.82 < kept / used < 0.88


def test_new_control_changes_nothing_and_an_empty_set_never_does():
    """A generator without exemplar control lends its weights; told or not, every logit is its own."""
    plain = generator()
    stage = GeneratorTask(config(exemplar=True), settings(exemplar=1.0), [TokenClip(*clip_arrays(0))])
    stage.begin_with(plain)
    window, exemplar = stage.draw(0).window, stage.draw(0).exemplar
    batch = build_sequences(plain.config.order, window.audio, window.motion, window.motion, torch.zeros(2).long())
    assert exemplar is not None
    assert exemplar.members.any()
    told = code_logits(stage.generator, batch, read(stage.generator, batch, exemplar), exemplar)
    assert torch.equal(told, code_logits(plain, batch, read(plain, batch)))
    strong, x = open_stream(generator(exemplar=True)), audio(2, 60)
    off, empty = (
        strong.step(x, strong.init_state(2), EVERYONE, exemplar=exemplar) for exemplar in (None, torch.zeros(2, 8))
    )
    assert torch.equal(off, empty)


@pytest.mark.parametrize(("sequence", "chunks"), [("interleaved", 8), ("prefix", 3)])
def test_the_stream_takes_the_codes_the_told_model_finds_likeliest(sequence, chunks):
    """Row 0 is told a set, row 1 another at half intensity; interleaved: from the third chunk to the fifth."""
    model = generator(exemplar=True, sequence=sequence)
    stream, x, sets = open_stream(model), audio(2, 20 * chunks), members({1, 2, 5}, {0, 7})
    sets[1] *= 0.5
    holds = torch.ones(2, 2 * chunks, dtype=torch.bool)
    if sequence == "interleaved":
        holds = ((torch.arange(16) >= 4) & (torch.arange(16) < 10)).expand(2, -1)
    state, parts = stream.init_state(2), []
    for at, chunk in enumerate(x.split(20, dim=1)):
        told = sets if holds[0, 2 * at] else None
        parts.append(stream.step(chunk, state, EVERYONE, temperature=torch.zeros(2), exemplar=told))
    codes = torch.cat(parts, 1)
    batch = build_sequences(model.config.order, x, codes, codes, torch.zeros(2, dtype=torch.int64))
    exemplar = Exemplar(sets, holds)
    logits = code_logits(model, batch, read(model, batch, exemplar), exemplar)
    best, last = logits.argmax(-1).transpose(0, 1), slice(-2 if sequence == "prefix" else None, None)
    assert torch.equal(best[..., last], batch.targets[..., last])
    untold = code_logits(model, batch, read(model, batch)).argmax(-1).transpose(0, 1)
    assert not torch.equal(untold[..., last], batch.targets[..., last])


def clip_arrays(seed, chunks=24):
    """Upper codes come from a set of two that changes every 6 chunks and that the sound does not tell."""
    rng = np.random.default_rng(seed)
    sound = rng.integers(16, size=(20 * chunks, 2))
    motion = rng.integers(8, size=(2 * chunks, 3, 2))
    for start in range(0, 2 * chunks, 12):
        motion[start : start + 12, 1, 0] = rng.choice(rng.choice(8, 2, replace=False), 12)
    return sound, motion, np.ones(2 * chunks, np.uint8)


@pytest.mark.slow
def test_trained_control_steers_and_lets_go(tmp_path):
    """After a short training the codes drawn come mostly from a set that is told, and no longer when it is not."""
    clips = [TokenClip(*clip_arrays(seed)) for seed in range(30)]
    training = settings(steps=90, batch=8, chunks=6, learning_rate=1e-2, warmup=5, exemplar=0.7, blind=0.3)
    model = train(GeneratorTask(config(layers=1, exemplar=True), training, clips), tmp_path).generator
    stream, x, sets = open_stream(model), audio(2, 400), members({2, 6}, {0, 3})
    state = stream.init_state(2)
    told = stream.step(x, state, EVERYONE, exemplar=sets)[:, :, 1, 0]
    inside = sets.gather(1, told).mean(1)
    assert bool((inside > 0.8).all())
    after = stream.step(x, state, EVERYONE)[:, 20:, 1, 0]
    assert bool((sets.gather(1, after).mean(1) < 0.6).all())
    weak = stream.step(x, stream.init_state(2), EVERYONE, exemplar=0.2 * sets)[:, :, 1, 0]
    assert sets.gather(1, weak).mean() < inside.mean()


def test_a_bias_needs_no_training():
    stream, x = open_stream(generator()), audio(2, 60)
    sets = members({2, 6}, {0, 3})
    codes = stream.step(x, stream.init_state(2), EVERYONE, bias=20 * sets)[:, :, 1, 0]
    assert bool(sets.gather(1, codes).all())


def test_control_is_saved_loaded_and_asked_for_by_name(tmp_path):
    generator(exemplar=True).save(tmp_path, {})
    assert Generator.load(tmp_path).exemplar is not None
    with pytest.raises(CheckpointError, match="exemplar"):
        GeneratorTask(config(), settings(exemplar=0.5), any_clips())


PROMPTED = {
    "sequence": "prefix",
    "exemplar": True,
    "control": "prompt",
    "layout": compact_layout(audio_codes=16, motion_layers=2, motion_codes=8, has_example=True),
}


def test_control_tokens_need_a_prompt() -> None:
    with pytest.raises(ValueError, match="prefix order"):
        config(**(PROMPTED | {"sequence": "interleaved"}))
    with pytest.raises(CheckpointError, match="before_example"):
        GeneratorTask(config(**(PROMPTED | {"layout": config().layout})), settings(exemplar=1.0), [])
    assert Generator(config(**PROMPTED)).exemplar is None  # no weight is added


def test_the_stream_reads_the_control_tokens_that_training_wrote() -> None:
    """Paper, Exemplar-Driven Control: a set in front of the window, one row without; the likeliest codes are drawn."""
    model = generator(**PROMPTED)
    stream, x, sets = open_stream(model), audio(2, 60), members({1, 2, 5}, set())
    state, parts = stream.init_state(2), []
    for chunk in x.split(20, dim=1):
        parts.append(stream.step(chunk, state, EVERYONE, temperature=torch.zeros(2), exemplar=sets))
    codes = torch.cat(parts, 1)
    order, layout = model.config.order, model.config.layout
    ids = control_ids(sets, layout.segment_start(2) + torch.arange(8))
    assert ids.tolist() == [[layout.segment_start(2) + code for code in (1, 2, 5)], [-1, -1, -1]]
    whole = build_sequences(order, x, codes, codes, torch.zeros(2, dtype=torch.int64), ids)
    best = code_logits(model, whole, read(model, whole)).argmax(-1).transpose(0, 1)
    assert torch.equal(best[..., -2:], whole.targets[..., -2:])
    untold = build_sequences(order, x, codes, codes, torch.zeros(2, dtype=torch.int64))
    other = code_logits(model, untold, read(model, untold)).argmax(-1).transpose(0, 1)
    assert not torch.equal(other[0, :, -2:], whole.targets[0, :, -2:])
    assert torch.equal(other[1, :, -2:], whole.targets[1, :, -2:])  # no set, no system prompt


@pytest.mark.slow
def test_trained_control_tokens_tell(tmp_path) -> None:
    """On new clips their own set in front costs less than another of the same size: the tokens are read."""
    training = settings(steps=220, batch=8, learning_rate=1e-2, warmup=20, exemplar=1.0, corruption="none", blind=1.0)
    clips = [TokenClip(*clip_arrays(seed)) for seed in range(30)]
    model = train(GeneratorTask(config(**PROMPTED, layers=2), training, clips), tmp_path).generator
    sounds, motions = zip(*(clip_arrays(seed)[:2] for seed in range(100, 140)), strict=True)
    sound, motion = torch.tensor(np.stack(sounds))[:, :60], torch.tensor(np.stack(motions))[:, :6]
    own = torch.zeros(40, 8).scatter_(1, motion[:, :, 1, 0], 1.0)
    order, ids = model.config.order, model.config.layout.segment_start(2) + torch.arange(8)
    costs = []
    for sets in (own, own.roll(4, 1)):
        batch = build_sequences(
            order, sound, motion, motion, torch.zeros(40, dtype=torch.int64), control_ids(sets, ids)
        )
        costs.append(code_nll(model, batch)[:, 2].mean().item())
    assert costs[0] < costs[1] - 0.1, costs
