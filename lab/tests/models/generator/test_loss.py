"""The loss against a loop over codes."""

import torch
from tests.models.generator.tiny import LAYOUT, audio, generator

from echoavatar_lab.models.generator.loss import code_nll, hierarchical_loss, summary
from echoavatar_lab.models.generator.windows import Window


def batch(model, missing=0):
    motion = torch.randint(8, (2, 4, 3, 2), generator=torch.Generator().manual_seed(1))
    window = Window(audio(2, 40), motion, torch.tensor([[0, 0, 1, 1], [2, 2, 2, 2]]), torch.zeros(2, 40, 2))
    none = torch.full((2,), missing)
    return window, model.config.order.build(window.audio, motion, motion, none)


def test_the_nll_is_that_of_the_next_id_among_its_segment():
    model = generator()
    window, sequences = batch(model)
    nll, logits = code_nll(model, sequences), model.lm_head(model(sequences.ids))
    for b, step, part, layer in ((0, 0, 0, 0), (1, 3, 2, 1), (0, 2, 1, 0)):
        segment, code = part * 2 + layer, int(window.motion[b, step, part, layer])
        rows = slice(LAYOUT.segment_start(segment), LAYOUT.segment_start(segment) + 8)
        at = int(sequences.predictors[segment, step])
        torch.testing.assert_close(nll[b, segment, step], -logits[b, at, rows].log_softmax(-1)[code])


def test_layers_are_weighted_by_their_depth_and_masked_steps_do_not_count():
    nll = torch.zeros(2, 6, 4)
    nll[:, 1::2, 2:] = 3.0  # the second layer of each part
    nll[:, :, :2] = 1e6  # the first chunk is masked
    _, sequences = batch(generator(sequence="prefix", window_chunks=2), missing=1)
    loss = hierarchical_loss(nll, sequences, (1.0, 0.5))
    torch.testing.assert_close(loss, torch.tensor(0.5 * 3.0 / 1.5))


def test_the_summary_splits_by_domain_and_layer():
    window, sequences = batch(generator())
    nll = torch.zeros(2, 6, 4)
    nll[0, :, 2:] = 4.0  # speech
    nll[1, 0::2] = 6.0  # music, first layers
    means = summary(nll, sequences, window)
    assert (means["nll_silence"], means["nll_speech"], means["nll_music"]) == (0.0, 4.0, 3.0)
    assert (means["nll_layer_0"], means["nll_layer_1"]) == (4.0, 1.0)


def test_the_mean_of_a_domain_that_is_not_there_is_no_number():
    window, sequences = batch(generator())
    means = summary(torch.zeros(2, 6, 4), sequences, window._replace(domain=torch.ones_like(window.domain)))
    assert means["nll_music"].isnan()
    assert means["nll_speech"] == 0
