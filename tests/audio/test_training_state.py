import pytest
import torch
from tests.audio.test_train import CONFIG

from echoavatar.audio.train import CodecTrainer
from echoavatar.audio.training_state import load_training, save_training
from echoavatar.errors import CheckpointError


def stepped() -> CodecTrainer:
    trainer = CodecTrainer(CONFIG)
    torch.stack([parameter.sum() for parameter in trainer.codec.encoder.parameters()]).sum().backward()
    trainer.optimizer.step()
    trainer.quantizer(torch.randn(1, 40, 8))
    trainer.steps_done, trainer.seconds = 7, 1.5
    return trainer


def test_everything_comes_back(tmp_path):
    saved, loaded = stepped(), CodecTrainer(CONFIG)
    save_training(tmp_path, saved)
    assert load_training(tmp_path, loaded)
    assert (loaded.steps_done, loaded.seconds) == (7, 1.5)
    for name, value in saved.quantizer.training_state().items():
        assert torch.equal(value, loaded.quantizer.training_state()[name])
    ours, theirs = saved.optimizer.state_dict()["state"], loaded.optimizer.state_dict()["state"]
    assert ours.keys() == theirs.keys()
    for index, moments in ours.items():
        for name, value in moments.items():
            assert torch.equal(value, theirs[index][name])


def test_nothing_to_go_on_with(tmp_path):
    assert not load_training(tmp_path, CodecTrainer(CONFIG))


def test_a_damaged_file_says_what_to_do(tmp_path):
    (tmp_path / "training.safetensors").write_bytes(b"\0" * 20)
    with pytest.raises(CheckpointError, match="is damaged .* delete it to start over"):
        load_training(tmp_path, CodecTrainer(CONFIG))
