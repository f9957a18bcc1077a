"""The auxiliary task: half-way up the generator tells beats and stresses, so that the layers above can use them."""

import torch
from tests.models.generator.tiny import audio, generator

from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK
from echoavatar_lab.models.generator.cues import CueReader, cue_loss


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
    batch = model.config.order.build(sound, motion, motion, torch.zeros(2).long())
    model.read(batch)
    reader.loss((sound < 2).long(), batch.predictors).backward()
    reached = [layer.mlp.down_proj.weight.grad is not None for layer in model.model.layers]
    assert reached == [True, True, True, False]


def test_a_motion_token_is_asked_when_in_its_own_chunk_cues_are():
    """With readouts made to answer one frame, the loss is least for cues at that frame."""
    model = generator().train()
    reader = CueReader(model)
    sound = audio(1, 2 * AUDIO_FRAMES_PER_CHUNK)
    motion = torch.zeros(1, 4, 3, 2, dtype=torch.int64)
    batch = model.config.order.build(sound, motion, motion, torch.zeros(1).long())
    with torch.no_grad():
        for head in (reader.now, reader.when):
            head.weight.zero_()
            head.bias.fill_(-6.0)
        reader.when.bias[2 * 7] = 6.0  # frame 7, beats
        losses = []
        for frame in (7, 12):
            cues = torch.zeros(1, 40, 2, dtype=torch.int64)
            cues[0, [frame, 20 + frame], 0] = 1
            model.read(batch)
            losses.append(reader.loss(cues, batch.predictors))
    assert losses[0] < 0.5 * losses[1]
