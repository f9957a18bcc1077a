"""The compiled loop draws what the loop in torch draws."""

import pytest
import torch
from tests.models.generator.tiny import audio, generator

from echoavatar_lab.models.generator.stream import open_stream


@pytest.mark.parametrize("precision", ["float32", "int8"])
@pytest.mark.parametrize("is_steered", [False, True])
def test_the_same_codes_as_operation_by_operation(precision, is_steered):
    """Three chunks, two seeds, temperature and nucleus on; the directive changes what is drawn."""
    model, x = generator(exemplar=True, temperature=0.7, cooling=0.8, top_p=0.9), audio(2, 60)
    members = torch.zeros(2, 8)
    members[:, [1, 5]] = 1
    told = {"exemplar": members, "bias": 3 * members} if is_steered else {}
    streams = [open_stream(model, precision) for _ in range(2)]
    assert streams[0]._decoder._compiled is not None
    streams[1]._decoder._compiled = None
    drawn = [
        stream.step(x, stream.init_state(2), torch.ones(2, dtype=torch.bool), seeds=torch.tensor([3, 4]), **told)
        for stream in streams
    ]
    assert torch.equal(*drawn)
    assert len(drawn[0].unique()) > 4


def test_a_row_alone_draws_what_it_draws_in_company():
    stream, x = open_stream(generator(), "int8"), audio(3, 80)
    seeds = torch.tensor([5, 6, 7])
    together = stream.step(x, stream.init_state(3), torch.ones(3, dtype=torch.bool), seeds=seeds)
    alone = stream.step(x[1:2], stream.init_state(1), torch.ones(1, dtype=torch.bool), seeds=seeds[1:2])
    assert torch.equal(together[1:2], alone)
