"""The model sees the past within its band, and predicts each segment by its own rows."""

import pytest
import torch
from tests.models.generator.tiny import LAYOUT, audio, config, generator

from echoavatar.errors import CheckpointError
from echoavatar.models.generator import Generator


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
    sequences = model.config.order.build(audio(2, 40), motion, motion, torch.zeros(2, dtype=torch.int64))
    hidden = model(sequences.ids)
    whole, sliced = model.lm_head(hidden), model.segment_logits(hidden, sequences.predictors)
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
