import torch
from tests.tokenizer.fixtures import small_config
from tests.tokenizer.test_train import CLIPS, TRAINING

from echoavatar.tokenizer.train import TokenizerRun
from echoavatar.tokenizer.training_state import load_training, save_training


def test_everything_comes_back(tmp_path):
    """Weights, both Adam averages, the codebooks' averages, the generator and the step."""
    first = TokenizerRun(small_config(), TRAINING, CLIPS)
    first.advance()
    save_training(tmp_path, first.tokenizer, first.optimizer, first.generator, first.step)
    second = TokenizerRun(small_config(), TRAINING.model_copy(update={"seed": 5}), CLIPS)
    load_training(tmp_path, second.tokenizer, second.optimizer, second.generator, second)
    assert second.step == 1
    assert torch.equal(second.generator.get_state(), first.generator.get_state())
    for mine, theirs in zip(second.tokenizer.parameters(), first.tokenizer.parameters(), strict=True):
        assert torch.equal(mine, theirs)
        for key, value in first.optimizer.state[theirs].items():
            assert torch.equal(second.optimizer.state[mine][key], value)
    for mine, theirs in zip(second.tokenizer.buffers(), first.tokenizer.buffers(), strict=True):
        assert torch.equal(mine, theirs)


def test_nothing_half_written_is_left(tmp_path):
    run = TokenizerRun(small_config(), TRAINING, CLIPS)
    save_training(tmp_path, run.tokenizer, run.optimizer, run.generator, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["training.safetensors"]
