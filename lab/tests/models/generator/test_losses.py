"""The loss against a loop over codes."""

import numpy as np
import torch
import torch.nn.functional as F
from lab.tests.models.generator.test_train import clips
from tests.models.generator.tiny import LAYOUT, audio, generator

from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK
from echoavatar_lab.models.generator.losses import (
    CueReader,
    StreamNll,
    _windows,
    code_nll,
    cue_loss,
    freeze_body,
    hierarchical_loss,
    nll_by_domain,
    stream_loss,
    stream_nll,
    summary,
)
from echoavatar_lab.models.generator.sequences import build_sequences, read
from echoavatar_lab.models.generator.windows import TokenClip, Window, WindowSampler
from echoavatar_lab.models.tokens import audio_ids, motion_ids


def batch(model, missing=0):
    motion = torch.randint(8, (2, 4, 3, 2), generator=torch.Generator().manual_seed(1))
    window = Window(
        audio(2, 40), motion, torch.tensor([[0, 0, 1, 1], [2, 2, 2, 2]]), torch.zeros(2, 40, 2), torch.zeros(2, 9)
    )
    none = torch.full((2,), missing)
    return window, build_sequences(model.config.order, window.audio, motion, motion, none)


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


WINDOW = WindowSampler(clips(), chunks=3).batch(0, 2)


def test_each_position_is_scored_under_the_codes_it_may_hold():
    """Against a naive loop: the code at (frame, layer) from all ids before it, under that layer's rows of the head."""
    model = generator()
    ids = torch.cat([torch.zeros(2, 1, dtype=torch.int64), audio_ids(LAYOUT, WINDOW.audio)], 1)
    nll = stream_nll(model, WINDOW)
    for frame, layer in ((0, 0), (0, 1), (7, 1), (40, 0)):
        at = 2 * frame + layer
        hidden = model(ids[:, : at + 1])[:, -1]
        first = LAYOUT.audio_base + layer * LAYOUT.audio_codes
        logits = hidden @ model.lm_head.weight[first : first + LAYOUT.audio_codes].T
        expected = F.cross_entropy(logits, WINDOW.audio[:, frame, layer], reduction="none")
        torch.testing.assert_close(nll.audio[:, frame, layer], expected, rtol=1e-4, atol=1e-5)
    moves = torch.cat([torch.zeros(2, 1, dtype=torch.int64), motion_ids(LAYOUT, WINDOW.motion)], 1)
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


def test_cue_loss_falls_when_cues_are_told_and_misses_cost_more_than_false_alarms():
    cues = torch.zeros(1, 20, 2, dtype=torch.int64)
    cues[0, ::5] = 1
    right = cue_loss(8.0 * (2 * cues.float() - 1), cues)
    all_off, all_on = (cue_loss(torch.full((1, 20, 2), level), cues) for level in (-4.0, 4.0))
    assert right < 0.01
    assert all_off > all_on > right


def test_the_task_teaches_the_lower_layers_and_leaves_the_upper_ones_alone():
    model = generator(layers=4).train()
    reader = CueReader(model)
    sound = audio(2, 3 * AUDIO_FRAMES_PER_CHUNK)
    motion = torch.zeros(2, 6, 3, 2, dtype=torch.int64)
    batch = build_sequences(model.config.order, sound, motion, motion, torch.zeros(2).long())
    read(model, batch)
    reader.loss((sound < 2).long(), batch.predictors).backward()
    reached = [layer.mlp.down_proj.weight.grad is not None for layer in model.model.layers]
    assert reached == [True, True, True, False]


def test_a_motion_token_is_asked_when_in_its_own_chunk_cues_are():
    """With readouts made to answer one frame, the loss is least for cues at that frame."""
    model = generator().train()
    reader = CueReader(model)
    sound = audio(1, 2 * AUDIO_FRAMES_PER_CHUNK)
    motion = torch.zeros(1, 4, 3, 2, dtype=torch.int64)
    batch = build_sequences(model.config.order, sound, motion, motion, torch.zeros(1).long())
    with torch.no_grad():
        for head in (reader.now, reader.when):
            head.weight.zero_()
            head.bias.fill_(-6.0)
        reader.when.bias[2 * 7] = 6.0  # frame 7, beats
        losses = []
        for frame in (7, 12):
            cues = torch.zeros(1, 40, 2, dtype=torch.int64)
            cues[0, [frame, 20 + frame], 0] = 1
            read(model, batch)
            losses.append(reader.loss(cues, batch.predictors))
    assert losses[0] < 0.5 * losses[1]


def clips():
    rng = np.random.default_rng(0)
    lengths = (7, 4, 6, 5)
    return [
        TokenClip(np.full((20 * n, 2), i), rng.integers(8, size=(2 * n, 3, 2)), np.full(2 * n, i % 3, np.uint8))
        for i, n in enumerate(lengths)
    ]


def test_every_window_hears_another_clip():
    windows, audio = _windows(clips(), 2, True)
    assert bool((windows.audio != audio).all())
    assert torch.equal(audio.flatten().sort().values, windows.audio.flatten().sort().values)


def test_domains_are_counted_apart_and_together():
    model = generator()
    apart = [nll_by_domain(model, [clip], chunks=2) for clip in clips()]
    means = nll_by_domain(model, clips(), chunks=2, batch=3)
    assert set(means) == {"silence", "speech", "music", "all"}
    torch.testing.assert_close(means["speech"], apart[1]["all"], atol=1e-5, rtol=1e-5)
    expected = sum(each["all"] * n for each, n in zip(apart, (3, 2, 3, 2), strict=True)) / 10
    torch.testing.assert_close(means["all"], expected, atol=1e-5, rtol=1e-5)
