"""What a generator is told of its speaker: drawn by a seed, heard alike in training and in a stream."""

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from tests.models.generator.tiny import audio, config, generator

from echoavatar.errors import CheckpointError
from echoavatar.models.generator.manner import MANNER, TOLD, Manner, busy, draw_manner, raised
from echoavatar_lab.models.generator.manner_control import MannerControl
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import build_sequences, code_logits, read
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.generator.train import GeneratorTask, GeneratorTraining
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.training import train

EVERYONE = torch.ones(2, dtype=torch.bool)
COLD = torch.zeros(2)
CALM, STORYTELLER = ((*Manner(liveliness=value).values, 0.5, 0.5, 0.2, 0.2 + value / 2) for value in (0.0, 1.0))


def test_manners_fill_their_range_and_follow_from_the_seed():
    assert draw_manner(4) == draw_manner(4)
    drawn = np.array([draw_manner(seed).values for seed in range(300)])
    assert drawn.min() >= 0
    assert drawn.max() <= 1
    assert np.ptp(drawn, axis=0).min() > 0.7
    assert 0.1 < (drawn[:, MANNER.index("right")] < 0.5).mean() < 0.35


def test_what_is_not_told_adds_nothing_and_each_number_has_its_own_effect():
    control = MannerControl(16, 8, 32)
    torch.nn.init.normal_(control.proj.weight)
    torch.nn.init.normal_(control.codes_proj.weight)
    told = torch.tensor([(*Manner().values, 0.6, 0.1, 0.3, 0.8)])
    one_by_one = [torch.where(torch.arange(len(TOLD)) == k, told, torch.nan) for k in range(len(TOLD))]
    for effect in (control.hint, control.likely):
        assert not effect(torch.full_like(told, torch.nan)).any()
        assert torch.allclose(sum(effect(each) for each in one_by_one), effect(told), atol=1e-5)


def test_a_talking_hand_is_half_busy():
    assert busy(np.array([0, 0.6, 100])) == pytest.approx([0, 0.5, 1], abs=0.01)


def test_a_hanging_hand_is_at_0_and_one_at_the_chin_at_1():
    assert raised(np.array([-1.1, -1, -0.4, 0.2, 0.5])) == pytest.approx([0, 0, 0.5, 1, 1])


def test_the_effect_changes_steadily_with_a_number():
    control = MannerControl(16, 8, 32)
    torch.nn.init.normal_(control.proj.weight)
    told = torch.tensor([(*Manner().values, 0.6, 0.1, 0.3, 0.8)]).repeat(101, 1)
    told[:, MANNER.index("liveliness")] = torch.linspace(0, 1, 101)
    steps = control.hint(told).diff(dim=0).norm(dim=1)
    assert steps.min() > 0
    assert steps.max() < 1


def test_the_stream_takes_the_codes_that_the_told_model_finds_likeliest():
    """Row 0 is told a calm speaker, row 1 a storyteller; beside a set of codes too."""
    model, x = generator(sequence="depth", manner=True), audio(2, 60)
    manner = torch.tensor([CALM, STORYTELLER])
    stream = open_stream(model)
    codes = stream.step(x, stream.init_state(2), EVERYONE, temperature=COLD, manner=manner)
    batch = build_sequences(model.config.order, x, codes, codes, torch.zeros(2, dtype=torch.int64))
    each = manner[:, None].expand(-1, codes.shape[1], -1)
    told = code_logits(model, batch, read(model, batch, manner=each), manner=each).argmax(-1).transpose(0, 1)
    assert torch.equal(told, batch.targets)
    untold = code_logits(model, batch, read(model, batch)).argmax(-1).transpose(0, 1)
    assert not torch.equal(untold, batch.targets)


def test_a_new_control_changes_nothing_and_its_weights_are_lent():
    plain = generator(sequence="depth")
    stage = GeneratorTask(
        config(sequence="depth", manner=True), GeneratorTraining(chunks=4, depth_weights=(1, 1)), clips()
    )
    stage.begin_with(plain)
    x, manner = audio(2, 60), torch.tensor([CALM, STORYTELLER])
    new, old = open_stream(stage.generator.eval()), open_stream(plain)
    told = new.step(x, new.init_state(2), EVERYONE, manner=manner)
    assert torch.equal(told, old.step(x, old.init_state(2), EVERYONE, manner=manner))


def test_it_is_saved_and_asked_for_by_name(tmp_path):
    generator(sequence="depth", manner=True).save(tmp_path, {})
    assert Generator.load(tmp_path).manner is not None
    with pytest.raises(CheckpointError, match="manner"):
        GeneratorTask(config(sequence="depth"), GeneratorTraining(depth_weights=(1, 1), manner=0.5), clips())
    with pytest.raises(ValidationError, match="depth order"):
        config(manner=True)


def clips(count=12, chunks=8):
    """Motion that the sound does not tell: calm speakers have the codes 0 to 3, storytellers 4 to 7."""
    rng, made = np.random.default_rng(0), []
    for number in range(count):
        sound = rng.integers(16, size=(20 * chunks, 2))
        motion = rng.integers(4, size=(2 * chunks, 3, 2)) + 4 * (number % 2)
        manner = np.tile(np.float32(STORYTELLER if number % 2 else CALM), (2 * chunks, 1))
        made.append(TokenClip(sound, motion, np.ones(2 * chunks, np.uint8), manner=manner))
    return made


def test_a_trained_generator_moves_as_it_is_told(tmp_path):
    training = GeneratorTraining(
        steps=60, batch=8, chunks=4, learning_rate=1e-2, warmup=5, manner=0.8, blind=0.3, depth_weights=(1, 1)
    )
    model = train(GeneratorTask(config(sequence="depth", layers=1, manner=True), training, clips()), tmp_path).generator
    stream, x = open_stream(model.eval()), audio(2, 100)
    manner = torch.tensor([CALM, STORYTELLER])
    moved = stream.step(x, stream.init_state(2), EVERYONE, manner=manner)
    assert (moved[0] < 4).float().mean() > 0.9
    assert (moved[1] >= 4).float().mean() > 0.9


def test_what_a_manner_does_may_be_learned_alone(tmp_path):
    training = GeneratorTraining(steps=3, batch=4, chunks=4, manner=1, only="manner", depth_weights=(1, 1))
    start = generator(sequence="depth", layers=1)
    task = GeneratorTask(config(sequence="depth", layers=1, manner=True), training, clips())
    task.begin_with(start)
    learned = train(task, tmp_path).generator.state_dict()
    assert all(torch.equal(learned[name], weight) for name, weight in start.state_dict().items())
    assert learned["manner.proj.weight"].any()


def test_where_no_manner_is_known_any_is_told_and_it_may_be_absent():
    known, unknown = clips(2)[0], TokenClip(*(getattr(clips(2)[0], name) for name in ("audio", "motion", "domain")))
    training = GeneratorTraining(batch=64, chunks=4, manner=0.75, depth_weights=(1, 1))
    for clip in (known, unknown):
        told = GeneratorTask(config(sequence="depth", manner=True), training, [clip]).draw(0).manner
        assert told.shape[1:] == (8, len(TOLD))
        told = told[:, 0]
        given = ~told.isnan().any(1)
        assert 0.5 < given.float().mean() < 0.95
        assert told[~given].isnan().all()
        assert (told[given].std(0) > 0.2).all() == (clip is unknown)
