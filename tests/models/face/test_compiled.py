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
        torch.testing.assert_close(frames(slice(row, row + 1))[0], together[row], atol=1e-5, rtol=1e-5)
    assert (together[0] - together[1]).abs().max() > 0.01
