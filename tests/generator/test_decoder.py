"""The rearranged body computes what the model computes."""

import pytest
import torch
from tests.generator.tiny import LAYOUT, generator

from echoavatar.generator.decoder import Decoder


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
        torch.testing.assert_close(
            decoder.logits(hidden, segment), expected[segment, :, 0], atol=1e-4, rtol=1e-4
        )
