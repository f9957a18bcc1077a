"""Sessions of one batch do not see each other in the compiled frame loop; that it is the model: test_decoder."""

import torch
from tests.models.face.tiny import CONFIG, make

from echoavatar.models.face.decoder import FrameDecoder


@torch.no_grad()
def test_a_session_alone_gets_the_face_that_it_gets_in_company():
    model = make(CONFIG).float()
    decoder, schedule = FrameDecoder(model), model.head.schedule(2)
    random = torch.Generator().manual_seed(1)
    sound, noise = (torch.randn(40, 8, CONFIG.width, generator=random), torch.randn(40, 8, 52, generator=random))

    def frames(rows: slice) -> torch.Tensor:
        heard = sound[rows]
        state, active = model.gpt.init_state(len(heard)), torch.ones(len(heard), dtype=torch.bool)
        return torch.from_numpy(decoder.run(state, heard, active, noise[rows], schedule))

    together = frames(slice(None))
    for row in (0, 1, 17, 39):
        assert torch.equal(frames(slice(row, row + 1))[0], together[row])
    assert (together[0] - together[1]).abs().max() > 0.01


@torch.no_grad()
def test_the_frame_loop_is_the_model_read_as_a_whole():
    """Eight frames from an empty ring: each is what backbone and head say of everything before it."""
    model = make(CONFIG.model_copy(update={"guidance": 1.7})).float()
    gpt, head = model.gpt, model.head
    generator = torch.Generator().manual_seed(3)
    sound = torch.randn(2, 8, CONFIG.width, generator=generator)
    noise = torch.randn(2, 8, 52, generator=generator)
    schedule = head.schedule(3)
    state = gpt.init_state(2)
    active = torch.ones(2, dtype=torch.bool)
    frames = torch.from_numpy(FrameDecoder(model).run(state, sound, active, noise, schedule))

    motion = torch.zeros(2, 1, 52)
    for i in range(8):
        blank = gpt(motion, torch.zeros_like(sound[:, : i + 1]))[:, -1]
        full = gpt(motion, sound[:, : i + 1])[:, -1]
        wanted = head.sample(torch.stack([blank, full], 1), noise[:, i], schedule, guidance=1.7)
        torch.testing.assert_close(frames[:, i], wanted, atol=1e-4, rtol=1e-4)
        motion = torch.cat([motion, wanted[:, None]], 1)


@torch.no_grad()
def test_a_ring_that_went_round_is_the_model_read_as_a_whole():
    """48 frames in a ring of 12 slots."""
    model = make(CONFIG).float()
    gpt, decoder, schedule = model.gpt, FrameDecoder(model), model.head.schedule(2)
    generator = torch.Generator().manual_seed(4)
    sound = torch.randn(1, 48, CONFIG.width, generator=generator)
    noise = torch.randn(1, 48, 52, generator=generator)
    state, active = gpt.init_state(1), torch.ones(1, dtype=torch.bool)
    parts = []
    for i in range(0, 48, 8):
        frames = decoder.run(state, sound[:, i : i + 8], active, noise[:, i : i + 8], schedule)
        parts.append(torch.from_numpy(frames))
        gpt.commit(state, parts[-1], sound[:, i : i + 8], active)
    made = torch.cat(parts, 1)
    motion = torch.cat([torch.zeros(1, 1, 52), made[:, :-1]], 1)
    branches = [gpt(motion, heard) for heard in (torch.zeros_like(sound), sound)]
    for i in range(48):
        condition = torch.stack([branch[:, i] for branch in branches], 1)
        wanted = model.head.sample(condition, noise[:, i], schedule, guidance=CONFIG.guidance)
        torch.testing.assert_close(made[:, i], wanted, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_idle_rows_keep_their_ring_and_get_nothing():
    model = make(CONFIG).float()
    state = model.gpt.init_state(2)
    state.ring.normal_()
    before = state.ring.clone()
    sound, noise = torch.randn(2, 8, CONFIG.width), torch.randn(2, 8, 52)
    active = torch.tensor([False, True])
    frames = FrameDecoder(model).run(state, sound, active, noise, model.head.schedule(1))
    assert torch.equal(state.ring[0], before[0])
    assert not torch.equal(state.ring[1], before[1])
    assert not frames[0].any()
    assert frames[1].any()
