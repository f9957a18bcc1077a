import pytest
import torch
from tests.models.face.tiny import make

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.face.train import normalized


def test_a_folder_gives_back_the_model(tmp_path):
    model = make().float()
    model.save(tmp_path, {"data": "none"})
    loaded = FaceModel.load(tmp_path)
    assert loaded.config == model.config
    for key, value in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[key], value)
    (tmp_path / "config.json").unlink()
    with pytest.raises(CheckpointError, match=r"config.json is missing"):
        FaceModel.load(tmp_path)


def test_normalised_curves_come_back_and_still_channels_stay_at_their_mean():
    model = make()
    curves = torch.rand(400, 52).double()
    curves[:, 3] = 0.25
    curves[:, 4] = 0.25 + 0.01 * curves[:, 4]
    model.mean.copy_(curves.mean(0))
    model.std.copy_(curves.std(0))
    normal = normalized(model, curves)
    torch.testing.assert_close(normal[:, 0].std(), torch.tensor(1.0).double())
    assert normal[:, 3].abs().max() == 0
    assert normal[:, 4].std() < 0.2  # a channel that hardly moves is not blown up
    torch.testing.assert_close(model.denormalize(normal), curves)
    assert model.denormalize(torch.full((1, 52), 9.0).double())[0, 3] == 0.25
