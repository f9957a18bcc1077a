"""BEATs: the parts by hand, the names of its published weights, and what is no such file."""

import pytest
import torch
import torch.nn.functional as F

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.beats_encoder import Beats, BeatsConfig, GatedAttention, PositionConv, _relative_buckets

SMALL = BeatsConfig(layers=2, width=24, heads=3, hidden=40, patch_width=10, buckets=16, farthest=800, reach=6, groups=4)


def small() -> Beats:
    torch.manual_seed(0)
    return Beats(SMALL).eval()


def as_published(model: Beats) -> dict[str, torch.Tensor]:
    """As in the published file: every layer has the one table, and there is a classifier."""
    table = "self_attn.relative_attention_bias.weight"
    state = dict(model.state_dict())
    state |= {f"encoder.layers.1.{table}": state[f"encoder.layers.0.{table}"]}
    return state | {"predictor.weight": torch.zeros(5, 24), "predictor.bias": torch.zeros(5)}


def test_published_weights_load_and_their_sizes_are_read_off():
    one, wave = small(), 0.1 * torch.randn(2, 16_000)
    again = Beats.from_published(as_published(one))
    assert again.config == SMALL
    torch.testing.assert_close(again(wave), one(wave))


def test_names_are_the_published_ones():
    names = set(small().state_dict())
    assert {
        "patch_embedding.weight",
        "layer_norm.weight",
        "post_extract_proj.bias",
        "encoder.pos_conv.0.weight_g",
        "encoder.pos_conv.0.weight_v",
        "encoder.layer_norm.weight",
        "encoder.layers.0.self_attn.relative_attention_bias.weight",
        "encoder.layers.1.self_attn.grep_linear.weight",
        "encoder.layers.1.self_attn.grep_a",
        "encoder.layers.1.self_attn_layer_norm.weight",
        "encoder.layers.1.fc2.bias",
        "encoder.layers.1.final_layer_norm.bias",
    } <= names
    assert "encoder.layers.1.self_attn.relative_attention_bias.weight" not in names


def test_a_state_every_160_ms():
    """4 s: 398 frames, 24 whole patches in time, 8 in frequency."""
    model, wave = small(), torch.zeros(1, 64_000)
    assert model(wave).shape == (1, 24, 24)
    assert model.patches(wave).shape == (1, 24 * 8, 24)


def test_other_weights_are_refused():
    with pytest.raises(CheckpointError, match="these are not BEATs weights"):
        Beats.from_published({"encoder.weight": torch.zeros(2)})
    short = as_published(small())
    del short["encoder.layers.1.fc1.weight"]
    with pytest.raises(CheckpointError, match="these are not BEATs weights"):
        Beats.from_published(short)


def test_distances_are_exact_up_close_and_grow_far_off():
    """16 buckets: 8 behind, 8 ahead; 0 to 3 exact, then by the logarithm, the last from 800 on."""
    near = _relative_buckets(2000, 16, 800)
    assert near[5, :9].tolist() == [4, 4, 3, 2, 1, 0, 9, 10, 11]
    assert near[0, 1999] == 15
    assert near[1999, 0] == 7
    assert (near[1000, :1001].diff() <= 0).all()


def test_attention_by_hand():
    """Softmax of q k / sqrt(d) + gate x bias, the gate of each query between 0 and 3."""
    torch.manual_seed(1)
    one = GatedAttention(SMALL)
    torch.nn.init.normal_(one.grep_a)
    x, bias = torch.randn(1, 5, 24), torch.randn(3, 5, 5)
    heads = []
    for h in range(3):
        rows = slice(8 * h, 8 * h + 8)
        q, k, v = (F.linear(x[0], part.weight[rows], part.bias[rows]) for part in (one.q_proj, one.k_proj, one.v_proj))
        raw = F.linear(q, one.grep_linear.weight, one.grep_linear.bias)
        a, b = torch.sigmoid(raw[:, :4].sum(1)), torch.sigmoid(raw[:, 4:].sum(1))
        gate = a * (b * one.grep_a[0, h, 0, 0] - 1) + 2
        heads.append(torch.softmax(q @ k.T / 8**0.5 + gate[:, None] * bias[h], -1) @ v)
    wanted = F.linear(torch.cat(heads, 1), one.out_proj.weight, one.out_proj.bias)
    torch.testing.assert_close(one(x, bias)[0], wanted)


def test_positions_are_a_weight_normed_convolution():
    torch.manual_seed(2)
    one, x = PositionConv(SMALL), torch.randn(2, 9, 24)
    conv = torch.nn.utils.parametrizations.weight_norm(torch.nn.Conv1d(24, 24, 6, padding=3, groups=4), dim=2)
    with torch.no_grad():
        conv.parametrizations.weight.original0.copy_(2 * one.weight_g)
        conv.parametrizations.weight.original1.copy_(one.weight_v)
        conv.bias.copy_(torch.randn(24))
        one.bias.copy_(conv.bias)
        one.weight_g.mul_(2)
    wanted = F.gelu(conv(x.transpose(1, 2))[..., :-1]).transpose(1, 2)
    torch.testing.assert_close(one(x), wanted)
