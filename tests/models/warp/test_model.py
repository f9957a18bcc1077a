from pathlib import Path

import pytest
import torch
from tests.models.warp.tiny import CONFIG

from echoavatar.errors import CheckpointError
from echoavatar.models.warp import WarpModel


def make() -> WarpModel:
    torch.manual_seed(0)
    return WarpModel(CONFIG).eval()


def test_a_curve_is_the_logits_made_steeper() -> None:
    model, sound = make(), torch.randn(1, 12_800)
    with torch.no_grad():
        logits = model.logits(model.encoder(sound))
        torch.testing.assert_close(model(sound), torch.sigmoid(1.5 * logits + 0.5))


def test_a_folder_gives_back_the_model(tmp_path: Path) -> None:
    model = make()
    model.save(tmp_path, {"data": "none"})
    loaded, sound = WarpModel.load(tmp_path), torch.randn(1, 6400)
    with torch.no_grad():
        torch.testing.assert_close(loaded(sound), model(sound), atol=0, rtol=0)
    (tmp_path / "model.safetensors").write_bytes(b"no")
    with pytest.raises(CheckpointError, match="safetensors"):
        WarpModel.load(tmp_path)
