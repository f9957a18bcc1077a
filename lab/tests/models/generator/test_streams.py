import torch
import torch.nn.functional as F
from lab.tests.models.generator.test_train import clips
from tests.models.generator.tiny import LAYOUT, generator

from echoavatar_lab.models.generator.streams import StreamNll, freeze_body, stream_loss, stream_nll
from echoavatar_lab.models.generator.windows import WindowSampler

WINDOW = WindowSampler(clips(), chunks=3).batch(0, 2)


def test_each_position_is_scored_under_the_codes_it_may_hold():
    """Against a naive loop: the code at (frame, layer) from all ids before it, under that layer's rows of the head."""
    model = generator()
    ids = torch.cat([torch.zeros(2, 1, dtype=torch.int64), LAYOUT.audio_ids(WINDOW.audio)], 1)
    nll = stream_nll(model, WINDOW)
    for frame, layer in ((0, 0), (0, 1), (7, 1), (40, 0)):
        at = 2 * frame + layer
        hidden = model(ids[:, : at + 1])[:, -1]
        first = LAYOUT.audio_base + layer * LAYOUT.audio_codes
        logits = hidden @ model.lm_head.weight[first : first + LAYOUT.audio_codes].T
        expected = F.cross_entropy(logits, WINDOW.audio[:, frame, layer], reduction="none")
        torch.testing.assert_close(nll.audio[:, frame, layer], expected, rtol=1e-4, atol=1e-5)
    moves = torch.cat([torch.zeros(2, 1, dtype=torch.int64), LAYOUT.motion_ids(WINDOW.motion)], 1)
    hidden = model(moves[:, : 6 * 2 + 4])[:, -1]  # before segment 3 of time step 2: upper body, layer 1
    first = LAYOUT.segment_start(3)
    logits = hidden @ model.lm_head.weight[first : first + LAYOUT.motion_codes].T
    expected = F.cross_entropy(logits, WINDOW.motion[:, 2, 1, 1], reduction="none")
    torch.testing.assert_close(nll.motion[:, 3, 2], expected, rtol=1e-4, atol=1e-5)


def test_sound_and_motion_do_not_see_each_other():
    model, other = generator(), WINDOW._replace(motion=(WINDOW.motion + 1) % 8)
    assert torch.equal(stream_nll(model, WINDOW).audio, stream_nll(model, other).audio)
    deaf = WINDOW._replace(audio=(WINDOW.audio + 1) % 16)
    assert torch.equal(stream_nll(model, WINDOW).motion, stream_nll(model, deaf).motion)


def test_the_loss_counts_both_streams_and_coarse_layers_more():
    """Sound 2 nats everywhere; motion 3 in first layers and 1 in second, weighted 3 to 1: (3 * 3 + 1) / 4 = 2.5."""
    motion = torch.tensor([3.0, 1.0]).repeat(3)[None, :, None].expand(2, 6, 5)
    assert stream_loss(StreamNll(torch.full((2, 4, 2), 2.0), motion), (3.0, 1.0)) == 0.5 * (2.0 + 2.5)


def test_a_frozen_body_leaves_the_embeddings_to_learn():
    model = generator(exemplar=True)
    freeze_body(model)
    learned = {name for name, parameter in model.named_parameters() if parameter.requires_grad}
    assert learned == {"model.embed_tokens.weight", "lm_head.weight"}
