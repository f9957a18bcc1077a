"""Rotary scores depend on distance alone, even after months."""

import math

import pytest
import torch

from echoavatar_lab.nn.attention import CausalAttention, lookback_mask, phase_table, rotary, rotary_phases, rotary_table


def product(q, k, at_q, at_k):
    table = phase_table(rotary_phases(torch.tensor([at_q, at_k]), width=8)).float()
    return (rotary(q[None], table[:, :1]) * rotary(k[None], table[:, 1:])).sum()


def test_products_depend_on_the_distance_alone_also_after_a_month_of_streaming():
    """A month is 30 x 86,400 s x 240 ids per second = 6e8 ids, where float32 phases would be off by whole rotations."""
    q, k = torch.randn(2, 8, generator=torch.Generator().manual_seed(0))
    near, far = product(q, k, 70, 3), product(q, k, 600_000_070, 600_000_003)
    torch.testing.assert_close(near, far, atol=1e-5, rtol=0)
    assert abs(product(q, k, 71, 3) - near) > 1e-3


def test_the_first_pair_rotates_one_radian_per_position():
    phases = rotary_phases(torch.tensor([7]), width=8)
    assert math.isclose(float(phases[0, 0]), 7 - 2 * math.pi)
    x = torch.zeros(1, 8, dtype=torch.double)
    x[..., 0] = 1
    y = rotary(x, rotary_table(8, 8)[:, 7:])[0]
    assert math.isclose(float(y[0]), math.cos(7))
    assert math.isclose(float(y[4]), math.sin(7))


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 16, generator=generator, dtype=torch.double)


@pytest.fixture
def attention() -> CausalAttention:
    torch.manual_seed(0)
    return CausalAttention(width=16, heads=2, lookback=5).double().eval()


def test_a_frame_sees_itself_and_the_lookback_by_gradient(attention):
    """Frame 9 with look-back 5 depends on frames 4..9."""
    x = frames(1, 12, torch.Generator().manual_seed(1)).requires_grad_()
    attention(x)[0, 9].sum().backward()
    seen = x.grad[0].abs().sum(-1).nonzero().flatten().tolist()
    assert seen == [4, 5, 6, 7, 8, 9]


def test_attention_matches_a_naive_loop(attention):
    """Frame by frame, head by head, with complex-number rotation."""
    x = frames(1, 9, torch.Generator().manual_seed(2))
    q, k, v = (attention.qkv(x)[0].view(9, 3, 2, 8)[:, i].detach() for i in range(3))
    rates = 10_000.0 ** (-torch.arange(4, dtype=torch.double) / 4)

    def turned(vector: torch.Tensor, position: int) -> torch.Tensor:
        return torch.complex(vector[:4], vector[4:]) * torch.polar(torch.ones_like(rates), position * rates)

    rows = []
    for t in range(9):
        heads = []
        for h in range(2):
            past = range(max(0, t - 5), t + 1)
            scores = torch.stack([(turned(q[t, h], t) * turned(k[s, h], s).conj()).real.sum() for s in past])
            weights = (scores / 8**0.5).softmax(0)
            heads.append(sum(w * v[s, h] for w, s in zip(weights, past, strict=True)))
        rows.append(torch.cat(heads))
    expected = attention.proj(torch.stack(rows))
    torch.testing.assert_close(attention(x)[0], expected, atol=1e-6, rtol=1e-6)


def test_clips_longer_than_the_table_go_the_same_way(attention):
    """Beyond 96 positions phases and mask are computed: the last frames of 130 equal a stream of single chunks."""
    x = frames(1, 130, torch.Generator().manual_seed(3))
    state = attention.init_state(1)
    streamed = torch.cat([attention.step(p, state, torch.tensor([True])) for p in x.split(10, 1)], 1)
    torch.testing.assert_close(streamed, attention(x), atol=1e-5, rtol=0)
    torch.testing.assert_close(attention.step(x, attention.init_state(1), torch.tensor([True])), attention(x))


def test_lookback_mask_by_hand():
    assert lookback_mask(3, 1).tolist() == [[True, False, False], [True, True, False], [False, True, True]]
    assert lookback_mask(2, 1, past=1).tolist() == [[True, True, False], [False, True, True]]


def test_the_state_has_constant_size(attention):
    state = attention.init_state(2)
    sizes = [tensor.shape for tensor in state.arrays()]
    for _ in range(3):
        attention.step(frames(2, 4, torch.Generator()), state, torch.tensor([True, True]))
    assert [tensor.shape for tensor in state.arrays()] == sizes


def test_odd_head_size_is_refused():
    with pytest.raises(ValueError, match="twice the heads"):
        CausalAttention(width=6, heads=2, lookback=3)
