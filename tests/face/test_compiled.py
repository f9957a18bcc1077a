"""Sessions of one batch do not see each other in the compiled frame loop; that it is the model: test_decoder."""

import torch
from tests.face.tiny import CONFIG, FLIPPED, make

from echoavatar.face.decoder import FrameDecoder


@torch.no_grad()
def test_a_session_alone_gets_the_face_that_it_gets_in_company():
    """40 sessions are two whole groups and half a one."""
    model = make(CONFIG).float()
    decoder, schedule = FrameDecoder(model), model.head.schedule(2)
    random = torch.Generator().manual_seed(1)
    sound, noise = (
        torch.randn(40, 8, CONFIG.width, generator=random),
        torch.randn(40, 8, 52, generator=random),
    )

    def frames(rows: slice) -> torch.Tensor:
        heard = sound[rows]
        state, active = model.gpt.init_state(len(heard)), torch.ones(len(heard), dtype=torch.bool)
        return torch.from_numpy(decoder.run(state, heard, active, noise[rows], schedule))

    together = frames(slice(None))
    for row in (0, 1, 17, 39):
        torch.testing.assert_close(frames(slice(row, row + 1))[0], together[row], atol=FLIPPED, rtol=FLIPPED)
    assert (together[0] - together[1]).abs().max() > 0.01


@torch.no_grad()
def test_two_threads_give_the_faces_of_one(monkeypatch):
    """40 sessions go as 20 and 20."""
    model = make(CONFIG).float()
    decoder, schedule = FrameDecoder(model), model.head.schedule(1)
    random = torch.Generator().manual_seed(2)
    sound, noise = (
        torch.randn(40, 8, CONFIG.width, generator=random),
        torch.randn(40, 8, 52, generator=random),
    )
    found = []
    for threads in (1, 2):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        state, active = model.gpt.init_state(40), torch.ones(40, dtype=torch.bool)
        found.append((torch.from_numpy(decoder.run(state, sound, active, noise, schedule)), state.ring))
    for one, two in zip(*found, strict=True):
        torch.testing.assert_close(one, two, atol=1e-5, rtol=1e-4)
