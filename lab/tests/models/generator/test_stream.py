"""Streams keep the five laws, and agree with the model that sees the whole sequence."""

import pytest
import torch
from tests.models.generator.tiny import audio, generator

from echoavatar_lab.models.generator.sequences import build_sequences, segment_logits
from echoavatar_lab.models.generator.stream import DepthStream, InterleavedStream, PrefixStream, open_stream

NONE = torch.zeros(2, dtype=torch.int64)


def greedy(stream, x):
    state, everyone = stream.init_state(2), torch.ones(2, dtype=torch.bool)
    return stream.step(x, state, everyone, temperature=torch.zeros(2))


def test_interleaved_decoding_takes_the_codes_the_model_finds_likeliest_long_after_the_ring_is_full():
    """8 chunks through a ring of 3: the witness is one banded pass over the whole sequence."""
    model = generator()
    x = audio(2, 160)
    codes = greedy(open_stream(model), x)
    sequences = build_sequences(model.config.order, x, codes, codes, NONE)
    best = segment_logits(model, model(sequences.ids), sequences.predictors).argmax(-1)
    assert torch.equal(best.transpose(0, 1), sequences.targets)


@pytest.mark.parametrize("chunks", [2, 5])
def test_prefix_decoding_takes_the_codes_the_model_finds_likeliest_in_its_window(chunks):
    """Window of 3 chunks: at the 2nd chunk one is missing, at the 5th the window has slid twice."""
    model = generator(sequence="prefix")
    x = audio(2, 20 * chunks)
    codes = greedy(open_stream(model), x)
    missing = max(0, 3 - chunks)
    window = torch.cat([torch.zeros(2, 20 * missing, 2, dtype=torch.int64), x], 1)[:, -60:]
    motion = torch.cat([torch.zeros(2, 2 * missing, 3, 2, dtype=torch.int64), codes], 1)[:, -6:]
    sequences = build_sequences(model.config.order, window, motion, motion, NONE + missing)
    best = segment_logits(model, model(sequences.ids, sequences.valid), sequences.predictors).argmax(-1)
    assert torch.equal(best.transpose(0, 1)[:, :, -2:], sequences.targets[:, :, -2:])


def test_rows_that_started_at_different_times_do_not_disturb_each_other():
    """Row 1 starts two chunks later; both equal a lone row with the same seed."""
    stream = open_stream(generator())
    x, seeds = audio(2, 120), torch.tensor([4, 9])
    state = stream.init_state(2)
    first = stream.step(x[:, :40], state, torch.tensor([True, False]), seeds=seeds)
    both = stream.step(x[:, 40:], state, torch.tensor([True, True]), seeds=seeds)
    for row, hours in ((0, torch.cat([first, both], 1)[:1]), (1, both[1:])):
        heard = x[row : row + 1] if row == 0 else x[1:, 40:]
        alone = stream.step(heard, stream.init_state(1), torch.ones(1, dtype=torch.bool), seeds=seeds[row : row + 1])
        assert torch.equal(alone, hours)


def test_seeds_change_the_motion_and_the_same_seed_repeats_it():
    stream = open_stream(generator())
    x, one = audio(1, 60), torch.ones(1, dtype=torch.bool)
    a, b, c = (stream.step(x, stream.init_state(1), one, seeds=torch.tensor([seed])) for seed in (1, 1, 2))
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


def test_the_size_of_the_state_is_constant():
    stream = open_stream(generator())
    state, one = stream.init_state(1), torch.ones(1, dtype=torch.bool)
    sizes = [t.shape for t in state.arrays()]
    stream.step(audio(1, 200), state, one)
    assert [t.shape for t in state.arrays()] == sizes


@pytest.mark.parametrize("precision", ["bfloat16", "int8"])
def test_lower_precision_mostly_agrees(precision):
    model = generator(width=64)
    x = audio(2, 60)
    exact, rough = greedy(open_stream(model), x), greedy(open_stream(model, precision), x)
    assert (exact[:, 0] == rough[:, 0]).float().mean() > 0.6


@pytest.mark.parametrize("sequence", ["interleaved", "prefix"])
def test_a_stream_primed_with_what_it_generated_goes_on_as_if_it_had_generated_it(sequence):
    """Five chunks through a window of three, told in two helpings, then one of its own; an idle row stays fresh."""
    stream, x = open_stream(generator(sequence=sequence)), audio(2, 120)
    everyone, seeds = torch.ones(2, dtype=torch.bool), torch.tensor([3, 5])
    state, told = stream.init_state(2), stream.init_state(2)
    past = stream.step(x[:, :100], state, everyone, seeds=seeds)
    stream.prime(x[:, :40], past[:, :4], told, everyone)
    stream.prime(x[:, 40:100], past[:, 4:], told, everyone)
    own = stream.step(x[:, 100:], state, everyone, seeds=seeds)
    assert torch.equal(stream.step(x[:, 100:], told, everyone, seeds=seeds), own)
    idle = stream.init_state(2)
    stream.prime(x[:, :20], past[:, :2], idle, torch.tensor([True, False]))
    for used, new in zip(idle.rows(slice(1, 2)).arrays(), stream.init_state(1).arrays(), strict=True):
        assert torch.equal(used, new)


@pytest.mark.parametrize(
    ("sequence", "kind"), [("interleaved", InterleavedStream), ("prefix", PrefixStream), ("depth", DepthStream)]
)
def test_every_order_has_its_stream(sequence, kind):
    assert type(open_stream(generator(sequence=sequence))) is kind


@pytest.mark.parametrize("sequence", ["depth", "interleaved", "prefix"])
def test_codes_are_drawn_as_often_as_they_are_likely_but_never_the_most_unlikely(sequence):
    """By default: a model without weights, whose logits are given; 96 % of the mass is on the first four codes."""
    model = generator(sequence=sequence)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.zero_()
    likely = torch.tensor([0.8, 0.08, 0.05, 0.03, 0.02, 0.01, 0.006, 0.004])
    stream, rows = open_stream(model), 64
    state, everyone = stream.init_state(rows), torch.ones(rows, dtype=torch.bool)
    bias = likely.log().expand(rows, -1)
    drawn = stream.step(audio(rows, 160), state, everyone, seeds=torch.arange(rows), bias=bias)[:, :, 1, 0]
    shares = torch.bincount(drawn.flatten(), minlength=8) / drawn.numel()
    torch.testing.assert_close(shares[:4], likely[:4] / 0.96, atol=0.04, rtol=0)
    assert not shares[4:].any()
