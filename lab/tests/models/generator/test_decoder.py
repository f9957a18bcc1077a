"""The rearranged body computes what the model computes."""

from copy import deepcopy

import pytest
import torch
from lab.tests.nn.traced import trace
from tests.models.generator.tiny import LAYOUT, audio, generator

from echoavatar_lab.models.generator.decoder import Decoder
from echoavatar_lab.models.generator.sampling import Sampler
from echoavatar_lab.models.generator.sequences import Exemplar, build_sequences, code_logits, read, segment_logits
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.nn.graphs import GraphCache


@pytest.mark.parametrize("cuts", [[9], [1] * 9, [4, 1, 3, 1]])
def test_reading_in_any_parts_gives_the_logits_of_the_model(cuts):
    model = generator(seed=3)
    ids = torch.randint(4, LAYOUT.vocabulary, (2, 9), generator=torch.Generator().manual_seed(0))
    at = torch.arange(9)
    seen = torch.cat([at[:, None] >= at, torch.zeros(9, 1, dtype=torch.bool)], 1).expand(2, -1, -1)
    with torch.no_grad():
        decoder = Decoder(model.model, model.segment_head(), "float32", control=model.exemplar)
        rings = decoder.rings(2, 9)
        places = decoder.places(at.expand(2, -1), at.expand(2, -1), seen, torch.ones(2, dtype=torch.bool))
        start = 0
        for part in cuts:
            hidden = decoder.run(ids[:, start : start + part], places.part(start, start + part), rings)
            start += part
        expected = segment_logits(model, model(ids), torch.full((6, 1), 8))
    for segment in range(6):
        torch.testing.assert_close(decoder.logits(hidden, segment), expected[segment, :, 0], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("sequence", ["interleaved", "prefix"])
@pytest.mark.parametrize("is_steered", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_captured_step_draws_the_codes_of_plain_calls(sequence, is_steered):
    """Five chunks, in which rows pause; what stands for the CUDA graph is the recorded operations (see `trace`)."""
    model = generator(sequence=sequence, exemplar=True, temperature=0.7, top_p=0.9)
    streams = [open_stream(model) for _ in range(2)]
    states = [stream.init_state(2) for stream in streams]
    for stream in streams:
        stream._decoder._compiled = None
    streams[1]._decoder._graphs._capture = trace
    members = torch.zeros(2, 8)
    members[:, [1, 5]] = 1
    directive = {"exemplar": members, "bias": 3 * members} if is_steered else {}
    for index, chunk in enumerate(audio(2, 100).split(20, 1)):
        active = torch.tensor([index != 2, index != 3])
        plain, captured = (
            stream.step(chunk, state, active, seeds=torch.tensor([3, 4]), **directive)
            for stream, state in zip(streams, states, strict=True)
        )
        assert torch.equal(captured[active], plain[active])
    assert len(streams[1]._decoder._graphs._graphs) > 0
    for one, other in zip(*(state.arrays() for state in states), strict=True):
        assert torch.equal(one, other)


NONE = torch.zeros(2, dtype=torch.int64)
EVERYONE = torch.ones(2, dtype=torch.bool)


def depth(**changes):
    return generator(sequence="depth", **changes)


def greedy(stream, x):
    return stream.step(x, stream.init_state(2), EVERYONE, temperature=torch.zeros(2))


def scores(model, x, codes, exemplar=None):
    """Logits (b, n, k, K) of given codes by the training pass over the whole clip."""
    sequences = build_sequences(model.config.order, x, codes, codes, NONE[: len(x)])
    return code_logits(model, sequences, read(model, sequences, exemplar), exemplar).permute(1, 2, 0, 3)


@pytest.mark.parametrize("loop", ["compiled", "torch"])
def test_it_takes_the_codes_the_model_finds_likeliest_long_after_the_ring_is_full(loop, monkeypatch):
    """8 chunks through a window of 3: the witness is one banded pass over the whole sequence."""
    if loop == "torch":
        monkeypatch.setattr(Decoder, "_compile", lambda _: None)
    model, x = depth(), audio(2, 160)
    stream = open_stream(model)
    codes = greedy(stream, x)
    assert torch.equal(scores(model, x, codes).argmax(-1), codes.flatten(2))


def test_the_stream_and_the_training_pass_give_the_same_log_probabilities(monkeypatch):
    """Every logit that the torch loop draws from, over 5 chunks, beside the teacher-forced ones."""
    monkeypatch.setattr(Decoder, "_compile", lambda _: None)
    model, x, seen = depth(), audio(2, 100), []
    stream = open_stream(model)

    def draw(sampler, logits, position):
        seen.append(logits)
        return (logits + sampler.noise[:, position]).argmax(1)

    monkeypatch.setattr(Sampler, "draw", draw)
    codes = stream.step(x, stream.init_state(2), EVERYONE, seeds=torch.tensor([5, 6]))
    streamed = torch.stack(seen, 1).view(2, 10, LAYOUT.segments, -1).log_softmax(-1)
    torch.testing.assert_close(streamed, scores(model, x, codes).log_softmax(-1), atol=1e-4, rtol=1e-4)


def test_a_frame_hears_its_own_sound_and_not_the_next_frames():
    model, x = depth(), audio(2, 40)
    codes = greedy(open_stream(model), x)
    for at in range(40):
        other = x.clone()
        other[:, at] = (other[:, at] + 1) % 16
        moved = (scores(model, other, codes) != scores(model, x, codes)).flatten(2).any(2).all(0)
        assert moved.tolist() == [frame >= at // 10 for frame in range(4)]


def test_within_a_frame_a_code_depends_on_those_before_it_and_a_window_has_an_end():
    model, x = depth(layers=1, window_chunks=1), audio(2, 60)
    codes = greedy(open_stream(model), x)
    before = scores(model, x, codes)
    other = codes.clone()
    other[:, 1, 1, 0] = (other[:, 1, 1, 0] + 1) % 8
    moved = (scores(model, x, other) != before).any(3).all(0)
    assert moved[1].tolist() == [False, False, False, True, True, True]
    assert moved[:, 0].tolist() == [False, False, True, True, False, False]  # window of 2 frames: heard in 2, seen in 3


def test_a_primed_stream_goes_on_as_if_it_had_drawn_and_a_copy_of_its_state_draws_the_same():
    stream, x, seeds = open_stream(depth()), audio(2, 120), torch.tensor([3, 5])
    state, told = stream.init_state(2), stream.init_state(2)
    past = stream.step(x[:, :100], state, EVERYONE, seeds=seeds)
    stream.prime(x[:, :40], past[:, :4], told, EVERYONE)
    stream.prime(x[:, 40:100], past[:, 4:], told, EVERYONE)
    kept = deepcopy(state)
    own = stream.step(x[:, 100:], state, EVERYONE, seeds=seeds)
    assert torch.equal(stream.step(x[:, 100:], told, EVERYONE, seeds=seeds), own)
    assert torch.equal(stream.step(x[:, 100:], kept, EVERYONE, seeds=seeds), own)
    idle = stream.init_state(2)
    stream.prime(x[:, :20], past[:, :2], idle, torch.tensor([True, False]))
    for used, new in zip(idle.rows(slice(1, 2)).arrays(), stream.init_state(1).arrays(), strict=True):
        assert torch.equal(used, new)


def test_a_directive_steers_as_in_training_and_a_bias_names_its_codes():
    model, x = depth(exemplar=True), audio(2, 60)
    members = torch.zeros(2, 8)
    members[:, 2] = 1.0
    stream = open_stream(model)
    state = stream.init_state(2)
    codes = stream.step(x, state, EVERYONE, temperature=torch.zeros(2), exemplar=members)
    told = scores(model, x, codes, Exemplar(members, torch.ones(2, 6, dtype=torch.bool)))
    assert torch.equal(told.argmax(-1), codes.flatten(2))
    assert not torch.equal(scores(model, x, codes).argmax(-1), codes.flatten(2))
    plain = open_stream(depth())
    forced = plain.step(x, plain.init_state(2), EVERYONE, exemplar=members, bias=100 * members)
    assert (forced[:, :, 1, 0] == 2).all()


@pytest.mark.parametrize("precision", ["bfloat16", "int8"])
def test_lower_precision_mostly_agrees(precision):
    model, x = depth(width=64, depth_width=64), audio(2, 60)
    exact, rough = greedy(open_stream(model), x), greedy(open_stream(model, precision), x)
    assert (exact[:, 0] == rough[:, 0]).float().mean() > 0.6


def test_a_captured_frame_draws_what_a_plain_one_does():
    """The graph is replaced by a replay that calls again: inputs must come through the graph's buffers."""
    stream, x = open_stream(depth()), audio(2, 60)
    plain = greedy(stream, x)

    def capture(run):
        run()
        return run

    decoder = stream._decoder
    decoder._frames = GraphCache(
        decoder._frame, lambda rings: [t for ring in rings for t in ring.arrays()], capture=capture
    )
    assert torch.equal(greedy(stream, x), plain)
