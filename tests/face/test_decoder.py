import torch
from tests.face.tiny import CONFIG, make

from echoavatar.face.decoder import FrameDecoder


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
    run = gpt.begin(state, sound)
    frames = torch.from_numpy(FrameDecoder(model).run(run, state.motion[:, -1], sound, noise, schedule))

    motion = torch.zeros(2, 1, 52)
    for i in range(8):
        blank = gpt(motion, torch.zeros_like(sound[:, : i + 1]))[:, -1]
        full = gpt(motion, sound[:, : i + 1])[:, -1]
        wanted = head.sample(torch.stack([blank, full], 1), noise[:, i], schedule, guidance=1.7)
        torch.testing.assert_close(frames[:, i], wanted, atol=2e-5, rtol=1e-4)
        motion = torch.cat([motion, wanted[:, None]], 1)
    assert run.at == run.past + 8
