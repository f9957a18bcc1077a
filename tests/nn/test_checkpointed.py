import pytest
import torch
from torch import nn

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.nn import Checkpointed


class SizeConfig(Config):
    width: int = 3


class Scale(Checkpointed):
    config_type = SizeConfig

    def __init__(self, config: SizeConfig) -> None:
        super().__init__()
        self.config = config
        self.factor = nn.Parameter(torch.zeros(config.width))


def test_a_saved_model_is_loaded_with_its_config_and_weights(tmp_path):
    model = Scale(SizeConfig(width=2))
    model.factor.data.fill_(0.1)
    model.save(tmp_path, {"licence": "Apache-2.0"}, dtype=torch.float16)
    loaded = Scale.load(tmp_path)
    assert (loaded.config, loaded.training, loaded.factor.dtype) == (model.config, False, torch.float32)
    torch.testing.assert_close(loaded.factor, model.factor, atol=1e-4, rtol=0)


def test_a_missing_file_is_named(tmp_path):
    Scale(SizeConfig()).save(tmp_path, {})
    (tmp_path / "model.safetensors").unlink()
    with pytest.raises(CheckpointError, match=r"model\.safetensors is missing"):
        Scale.load(tmp_path)
