"""The rearranged body computes what the model computes."""

import pytest
import torch
from tests.models.generator.tiny import LAYOUT, audio, generator
from tests.nn.traced import trace

from echoavatar.models.generator import open_stream
from echoavatar.models.generator.decoder import Decoder


@pytest.mark.parametrize("cuts", [[9], [1] * 9, [4, 1, 3, 1]])
def test_reading_in_any_parts_gives_the_logits_of_the_model(cuts):
    model = generator(seed=3)
    ids = torch.randint(4, LAYOUT.vocabulary, (2, 9), generator=torch.Generator().manual_seed(0))
    at = torch.arange(9)
    seen = torch.cat([at[:, None] >= at, torch.zeros(9, 1, dtype=torch.bool)], 1).expand(2, -1, -1)
    with torch.no_grad():
        decoder = Decoder(model, "float32")
        rings = decoder.rings(2, 9)
        places = decoder.places(at.expand(2, -1), at.expand(2, -1), seen, torch.ones(2, dtype=torch.bool))
        start = 0
        for part in cuts:
            hidden = decoder.run(ids[:, start : start + part], places.part(start, start + part), rings)
            start += part
        expected = model.segment_logits(model(ids), torch.full((6, 1), 8))
    for segment in range(6):
        torch.testing.assert_close(decoder.logits(hidden, segment), expected[segment, :, 0], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("sequence", ["interleaved", "prefix"])
@pytest.mark.parametrize("is_steered", [False, True])
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
    for one, other in zip(*(state.tensors() for state in states), strict=True):
        assert torch.equal(one, other)
