"""The rows that can occur, and that the same prompt comes of them."""

import json

import pytest
import torch

from echoavatar.errors import CheckpointError
from echoavatar.models.generator import GeneratorConfig
from echoavatar_lab.models.tokens import prefix_prompt
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT, StoredGenerator, compacted, occurring


def test_of_166690_rows_11270_are_kept():
    rows, layout = occurring(), compacted()
    assert len(rows) == layout.vocabulary == 6 + 2048 + 9216
    assert len(set(rows.tolist())) == len(rows)
    assert rows.max() < REFERENCE_LAYOUT.vocabulary


def test_a_prompt_over_the_kept_rows_is_the_published_prompt():
    random = torch.Generator().manual_seed(0)
    audio = torch.randint(1024, (1, 300, 2), generator=random)
    motion = torch.randint(512, (1, 27, 3, 6), generator=random)
    missing, prompts = torch.zeros(1, dtype=torch.int64), []
    for layout in (compacted(), REFERENCE_LAYOUT):
        config = GeneratorConfig(layout=layout, sequence="prefix")
        shown = torch.tensor([[layout.segment_start(6) + 93, layout.segment_start(0) + 495]])
        prompts.append(prefix_prompt(config.order, audio, motion, missing, shown)[0])
    assert torch.equal(occurring()[prompts[0]], prompts[1])


def test_rows_come_in_the_wanted_order(download):
    stored = StoredGenerator.open(download / "ckpts/body_g")
    rows = stored.read("lm_head.weight", torch.tensor([156_690, 7]))
    whole = stored.read("lm_head.weight")
    assert torch.equal(rows, whole[[156_690, 7]])
    assert whole.shape == (166_690, 16)
    assert not stored.is_tied


def test_sizes_are_those_of_its_own_config(download):
    config = StoredGenerator.open(download / "ckpts/body_g").generator_config(step=3, silence=(1, 2))
    assert (config.width, config.layers, config.step, config.top_p) == (16, 2, 3, 1.0)
    assert config.opening.motion == 32
    assert config.directed == (6, 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vocab_size": 151_936}, "vocab_size is 151936, wanted 166690"),
        ({"hidden_size": None}, "does not describe the generator"),
        ({"architectures": ["LlamaForCausalLM"]}, "LlamaForCausalLM.*, not a Qwen2"),
        ({"architectures": []}, "not a Qwen2"),
        ({"num_hidden_layers": 10**9}, "1000000000 layers of"),
    ],
)
def test_another_model_is_named(spoilt, changes, message):
    path = spoilt("ckpts/body_g/config.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(CheckpointError, match=message):
        StoredGenerator.open(path.parent).generator_config(step=2, silence=(1, 2))


def test_files_that_are_missing_or_cut_off_are_named(spoilt, tmp_path):
    path = spoilt("ckpts/body_g/model.safetensors")
    path.write_bytes(path.read_bytes()[:100_000])
    with pytest.raises(CheckpointError, match=r"model\.safetensors is damaged or cut off"):
        StoredGenerator.open(path.parent)
    path.unlink()
    with pytest.raises(CheckpointError, match=r"has no \*\.safetensors"):
        StoredGenerator.open(path.parent)
    with pytest.raises(CheckpointError, match=r"config\.json cannot be read"):
        StoredGenerator.open(tmp_path)
