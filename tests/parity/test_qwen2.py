"""Our body against transformers' Qwen2 on random weights, and its weights read back."""

import pytest
import torch

from echoavatar.errors import CheckpointError
from echoavatar.models.generator import GeneratorConfig
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.published import init_from_qwen

transformers = pytest.importorskip("transformers")
LAYOUT = compact_layout(audio_codes=11, motion_layers=2, motion_codes=7)


def pair():
    config = GeneratorConfig(
        layout=LAYOUT, sequence="prefix", width=32, layers=3, heads=4, kv_heads=2, mlp=56, rope_theta=1e6
    )
    theirs = transformers.Qwen2ForCausalLM(
        transformers.Qwen2Config(
            vocab_size=LAYOUT.vocabulary,
            hidden_size=32,
            num_hidden_layers=3,
            num_attention_heads=4,
            num_key_value_heads=2,
            intermediate_size=56,
            rms_norm_eps=1e-6,
            rope_parameters={"rope_type": "default", "rope_theta": 1e6},
            tie_word_embeddings=False,
        )
    ).eval()
    random = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in theirs.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=random) * 0.2)
    return Generator(config).eval(), theirs


def test_hidden_states_and_logits_equal_those_of_transformers():
    ours, theirs = pair()
    ours.load_state_dict(theirs.state_dict())
    ids = torch.randint(LAYOUT.vocabulary, (2, 300), generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        hidden = ours(ids)
        torch.testing.assert_close(hidden, theirs.model(ids).last_hidden_state, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(ours.lm_head(hidden), theirs(ids).logits, atol=1e-5, rtol=1e-5)


def test_a_local_checkpoint_initialises_the_body_and_leaves_the_embeddings(tmp_path):
    ours, theirs = pair()
    theirs.save_pretrained(tmp_path)
    before = ours.model.embed_tokens.weight.detach().clone()
    init_from_qwen(ours, tmp_path)
    own, source = ours.state_dict(), theirs.state_dict()
    body = [key for key in own if key.startswith(("model.layers", "model.norm"))]
    assert len(body) == 3 * 12 + 1
    assert all(torch.equal(own[key], source[key]) for key in body)
    assert torch.equal(ours.model.embed_tokens.weight, before)


def test_a_checkpoint_of_another_size_is_refused(tmp_path):
    _, theirs = pair()
    theirs.save_pretrained(tmp_path)
    other = Generator(GeneratorConfig(layout=LAYOUT, width=64, layers=3, heads=4, kv_heads=2, mlp=56))
    with pytest.raises(CheckpointError, match="does not fit"):
        init_from_qwen(other, tmp_path)
