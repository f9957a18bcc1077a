"""The step in fixed shapes against the stream that everything else uses."""

import pytest
import torch
from tests.generator.tiny import generator
from tests.parity.test_reference_prompt import TINY

from echoavatar.generator import open_stream
from echoavatar.generator.config import Opening
from echoavatar.generator.graphed import GraphedPrefix


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("temperature", [0.0, 1.0])
def test_codes_are_those_of_the_stream(step: int, temperature: float) -> None:
    """Two rows, one with an example; the graph's prompt has room for more in front, which does not count."""
    model = generator(
        sequence="prefix",
        layout=TINY,
        step=step,
        opening=Opening(silence=(3, 4), motion=5),
        steered=(2, 0),
        top_p=1.0,
    )
    config, stream, seeds = model.config, open_stream(model), torch.tensor([4, 9])
    members = torch.zeros(2, 16)
    members[1, [6, 11]] = 1
    heat, everyone = torch.full((2,), temperature), torch.ones(2, dtype=torch.bool)
    x = torch.randint(16, (2, 3 * config.audio_frames, 2), generator=torch.Generator().manual_seed(step))
    state, graph = stream.init_state(2), None
    for chunk in x.split(config.audio_frames, 1):
        audio = torch.cat([state.audio, chunk], 1)[:, config.audio_frames :]
        steer = stream._decoder.steer(members, 5 * members)
        prompt, valid = stream._prompt(audio, state.motion[:, step:], state.chunks, steer)
        room = torch.zeros(2, 5, dtype=torch.int64)
        prompt, valid = torch.cat([room, prompt], 1), torch.cat([room.bool(), valid], 1)
        graph = graph or GraphedPrefix(model, rows=2, length=prompt.shape[1], dtype=torch.float32)
        ours = graph.step(
            prompt, valid, seeds=seeds, heard=state.chunks.clone(), temperature=heat, bias=5 * members
        )
        theirs = stream.step(
            chunk, state, everyone, seeds=seeds, temperature=heat, exemplar=members, bias=5 * members
        )
        assert torch.equal(config.layout.unflatten(ours), theirs)
