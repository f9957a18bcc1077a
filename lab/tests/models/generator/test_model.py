"""The model sees the past within its band, and predicts each segment by its own rows."""

import json

import pytest
import torch
import torch.nn.functional as F
from lab.tests.models.generator.test_train import clips, settings
from tests.models.generator.tiny import LAYOUT, audio, config, generator

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.generator import model as attention
from echoavatar_lab.models.generator.losses import CueReader, code_nll, freeze_body, nll_by_domain, stream_nll
from echoavatar_lab.models.generator.model import Generator, banded_attention, masked_attention
from echoavatar_lab.models.generator.sequences import build_sequences, read, segment_logits
from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.models.generator.windows import WindowSampler, draw_exemplar
from echoavatar_lab.models.tokens import audio_ids, motion_ids
from echoavatar_lab.training import train


def naive(q, k, v, lookback, valid=None):
    out = torch.zeros_like(q)
    for b in range(q.shape[0]):
        for t in range(q.shape[2]):
            seen = range(max(0, t - (lookback or t + 1) + 1), t + 1)
            keys = [s for s in seen if valid is None or valid[b, s] or s == t]
            weights = torch.softmax(q[b, :, t, None] @ k[b][:, keys].transpose(1, 2) / q.shape[3] ** 0.5, -1)
            out[b, :, t] = (weights @ v[b][:, keys])[:, 0]
    return out


def inputs(length):
    random = torch.Generator().manual_seed(length)
    return torch.randn(3, 2, 2, length, 4, generator=random, dtype=torch.double).unbind()


@pytest.mark.parametrize("lookback", [None, 1, 5, 40])
@pytest.mark.parametrize("length", [3, 23])
def test_the_band_is_exact_for_any_block_border(monkeypatch, lookback, length):
    monkeypatch.setattr(attention, "BLOCK", 7)
    q, k, v = inputs(length)
    torch.testing.assert_close(banded_attention(q, k, v, lookback), naive(q, k, v, lookback))


def test_positions_that_do_not_count_are_not_seen():
    q, k, v = inputs(12)
    valid = torch.ones(2, 12, dtype=torch.bool)
    valid[0, 2:6] = False
    torch.testing.assert_close(masked_attention(q, k, v, None, valid), naive(q, k, v, None, valid))


def test_a_position_sees_exactly_its_lookback():
    """One layer, window 1 chunk = 40 + 12 ids: position 60 sees ids 9..60."""
    model = generator(layers=1, window_chunks=1)
    ids, hints = audio(1, 35).flatten(1), torch.zeros(1, 70, 32, requires_grad=True)
    model(ids, hints=hints)[0, 60].sum().backward()
    seen = hints.grad[0].abs().sum(1).nonzero().flatten().tolist()
    assert seen == list(range(9, 61))


def test_segment_logits_are_the_rows_of_the_whole_head():
    model = generator()
    motion = torch.randint(8, (2, 4, 3, 2))
    sequences = build_sequences(model.config.order, audio(2, 40), motion, motion, torch.zeros(2, dtype=torch.int64))
    hidden = model(sequences.ids)
    whole, sliced = model.lm_head(hidden), segment_logits(model, hidden, sequences.predictors)
    for segment in (0, 5):
        rows = slice(LAYOUT.segment_start(segment), LAYOUT.segment_start(segment) + 8)
        at = int(sequences.predictors[segment, 3])
        torch.testing.assert_close(sliced[segment, :, 3], whole[:, at, rows])


def test_a_checkpoint_comes_back_and_a_foreign_one_is_refused(tmp_path):
    model = generator()
    model.save(tmp_path, {"kind": "generator"})
    ids = torch.arange(30)[None]
    torch.testing.assert_close(Generator.load(tmp_path)(ids), model(ids))
    (tmp_path / "config.json").write_text(config(mlp=56).model_dump_json())
    with pytest.raises(CheckpointError, match="gate_proj"):
        Generator.load(tmp_path)


WINDOW = WindowSampler(clips(), chunks=3).batch(0, 2)
NONE = torch.zeros(2, dtype=torch.int64)


def sequences(model, window=WINDOW):
    return build_sequences(model.config.order, window.audio, window.motion, window.motion, NONE)


def test_hidden_states_are_those_of_a_naive_loop_over_frames_and_codes():
    model = generator(sequence="depth")
    depth, table = model.depth, model.model.embed_tokens
    hidden = read(model, sequences(model)).view(2, 6, LAYOUT.segments, -1)
    sound = audio_ids(LAYOUT, WINDOW.audio).view(2, 6, 10, 2)
    moves = motion_ids(LAYOUT, WINDOW.motion).view(2, 6, LAYOUT.segments)
    frames = []
    for frame in range(6):
        heard = table(sound[:, frame, :, 0]) + table(sound[:, frame, :, 1])
        last = table(moves[:, frame - 1]).sum(1) if frame else table(torch.zeros(2, dtype=torch.int64))
        frames.append(depth.sound(heard.flatten(1)) + last)
    backbone = model.model(torch.stack(frames, 1), torch.arange(6)[None], 6)
    for frame, code in ((0, 0), (0, 3), (4, 0), (5, 5)):
        inputs = [depth.condition(backbone[:, frame])]
        for before in range(code):
            inputs.append(inputs[0] + depth.body.embed_tokens(moves[:, frame, before]))
        expected = depth.body(torch.stack(inputs, 1), torch.arange(code + 1)[None], None)[:, -1]
        torch.testing.assert_close(hidden[:, frame, code], expected, atol=1e-4, rtol=1e-4)


def test_asking_for_some_frames_gives_their_losses_among_those_of_all():
    model = generator(sequence="depth", exemplar=True)
    torch.nn.init.normal_(model.exemplar.hint_proj.weight)
    torch.nn.init.normal_(model.exemplar.gate_proj.weight)
    exemplar = draw_exemplar(WINDOW.motion, 1.0, codes=8, whole=False, generator=torch.Generator().manual_seed(3))
    asked = torch.tensor([0, 3, 4])
    everything = code_nll(model, sequences(model), exemplar=exemplar)
    some = code_nll(model, sequences(model).asking(asked), exemplar=exemplar)
    torch.testing.assert_close(some, everything[:, :, asked])


def test_a_training_run_that_asks_for_a_third_of_the_frames_learns(tmp_path):
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5, cue_weight=0.1, asked=0.34, exemplar=0.0)
    train(GeneratorTask(config(sequence="depth"), training, clips(8)), tmp_path)
    rows = [json.loads(row) for row in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["codes"] < 0.7 * rows[0]["codes"]


@pytest.mark.parametrize("autocast", [False, True])
def test_a_few_steps_lower_the_loss(tmp_path, autocast):
    training = settings(steps=40, batch=8, learning_rate=5e-3, warmup=5, cue_weight=0.1, autocast=autocast)
    train(GeneratorTask(config(sequence="depth"), training, clips(8)), tmp_path)
    rows = [json.loads(row) for row in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["codes"] < 0.6 * rows[0]["codes"]
    assert rows[-1]["cues"] < rows[0]["cues"]


def test_it_learns_to_follow_the_audio_and_keeps_its_weights(tmp_path):
    """As `test_train` asks of the flattened order: uniform guessing costs 2.08 nats."""
    training = settings(steps=100, batch=8, learning_rate=5e-3, warmup=5)
    train(GeneratorTask(config(sequence="depth", layers=1), training, clips(16)), tmp_path)
    model, held = Generator.load(tmp_path), clips(20)[16:]
    true, shuffled = nll_by_domain(model, held), nll_by_domain(model, held, shuffled_audio=True)
    assert true["speech"] < 1.0
    assert shuffled["speech"] > true["speech"] + 0.4


def test_streams_of_one_kind_do_not_see_each_other_and_predict_from_the_past():
    model = generator(sequence="depth")
    nll = stream_nll(model, WINDOW)
    moved = stream_nll(model, WINDOW._replace(motion=(WINDOW.motion + 1) % 8))
    deaf = stream_nll(model, WINDOW._replace(audio=(WINDOW.audio + 1) % 16))
    assert torch.equal(nll.audio, moved.audio)
    assert torch.equal(nll.motion, deaf.motion)
    assert nll.audio.shape == WINDOW.audio.shape
    later = WINDOW.audio.clone()
    later[:, 33, 1] = (later[:, 33, 1] + 1) % 16
    same = stream_nll(model, WINDOW._replace(audio=later)).audio == nll.audio
    assert same[:, :33].all()
    assert same[:, 33, 0].all()
    assert not same[:, 33, 1].any()


def test_in_stage_one_the_backbone_alone_is_frozen():
    model = generator(sequence="depth", exemplar=True)
    freeze_body(model)
    frozen = {name for name, parameter in model.named_parameters() if not parameter.requires_grad}
    assert {name.split(".")[0] for name in frozen} == {"model", "exemplar"}
    assert "model.embed_tokens.weight" not in frozen


def test_a_frame_is_asked_for_the_cues_of_its_own_ten_audio_frames():
    model = generator(sequence="depth").train()
    reader = CueReader(model)
    cues = torch.zeros(2, 60, 2, dtype=torch.int64)
    cues[:, 12, 1] = 1
    with torch.no_grad():
        reader.now.weight.zero_()
        reader.now.bias.copy_(F.one_hot(torch.tensor(2 * 2 + 1), 20) * 20.0 - 10.0)  # frame 2 of ten, stress
    losses = []
    for shift in (0, 1):
        batch = sequences(model)
        read(model, batch)
        losses.append(reader.loss(cues.roll(shift, 1), batch.predictors))
    assert losses[0] < losses[1]
