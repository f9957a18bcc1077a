from pathlib import Path

import pytest
import torch
from tests.models.fingers.moving import TINY

from echoavatar.errors import CheckpointError
from echoavatar.models.fingers import FingerModel, load_shipped
from echoavatar.models.fingers.body_features import BODY_SIZE


def inputs(rows: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    torch.manual_seed(0)
    hands = torch.randn(rows, TINY.frames, 2, TINY.poses)
    unknown = torch.zeros(rows, TINY.frames, 2, dtype=torch.bool)
    return hands, unknown, torch.full((rows,), 0.5), torch.randn(rows, TINY.frames, BODY_SIZE)


def test_every_frame_is_seen_by_every_other_and_rows_do_not_mix() -> None:
    model = FingerModel(TINY)
    hands, unknown, level, body = inputs()
    body.requires_grad_()
    out = model(hands, unknown, level, body)
    assert out.shape == hands.shape
    out[0, 3].sum().backward()
    assert body.grad is not None
    seen = body.grad.abs().sum(-1) > 0
    assert seen[0].all()
    assert not seen[1].any()


def test_the_output_depends_on_known_hands_and_noise_level() -> None:
    model = FingerModel(TINY)
    hands, unknown, level, body = inputs()
    plain = model(hands, unknown, level, body)
    assert not torch.allclose(model(hands, ~unknown, level, body), plain)
    assert not torch.allclose(model(hands, unknown, level / 2, body), plain)


def test_a_model_comes_back_from_its_folder_up_to_half_precision(tmp_path: Path) -> None:
    model = FingerModel(TINY).eval()
    model.save(tmp_path, {"data": "none"})
    again = FingerModel.load(tmp_path)
    torch.testing.assert_close(again(*inputs()), model(*inputs()), atol=5e-3, rtol=5e-3)
    (tmp_path / "config.json").unlink()
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        FingerModel.load(tmp_path)


def test_the_shipped_model_is_small_and_knows_hands() -> None:
    model = load_shipped()
    assert sum(p.numel() for p in model.parameters()) < 1.5e6
    assert (model.hand_scale > 0).all()
    assert model.hand_mean.abs().max() > 0.5
