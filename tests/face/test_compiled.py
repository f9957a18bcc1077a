"""Sessions of one batch do not see each other in the compiled frame loop; that it is the model: test_decoder."""

import torch
from tests.face.tiny import CONFIG, make

from echoavatar.face.decoder import FrameDecoder


@torch.no_grad()
def test_a_session_alone_gets_the_face_that_it_gets_in_company():
    model = make(CONFIG).float()
    decoder, schedule = FrameDecoder(model), model.head.schedule(2)
    random = torch.Generator().manual_seed(1)
    sound, noise = torch.randn(3, 8, CONFIG.width, generator=random), torch.randn(3, 8, 52, generator=random)

    def frames(rows: slice) -> torch.Tensor:
        state = model.gpt.init_state(len(sound[rows]))
        run = model.gpt.begin(state, sound[rows])
        return torch.from_numpy(decoder.run(run, state.motion[:, -1], sound[rows], noise[rows], schedule))

    together = frames(slice(None))
    for row in range(3):
        torch.testing.assert_close(frames(slice(row, row + 1))[0], together[row], atol=1e-5, rtol=1e-4)
    assert (together[0] - together[1]).abs().max() > 0.01
