import torch

from echoavatar.models.face.attention import (
    Attention,
    RingAttention,
    RotaryVectorAttention,
    SinusoidAttention,
    rotate_pairs,
    sinusoids,
)


def x(rows: int = 2, frames: int = 9) -> torch.Tensor:
    return torch.randn(rows, frames, 8, generator=torch.Generator().manual_seed(1)).double()


@torch.no_grad()
def test_one_by_one_gives_the_whole_window():
    for kind in (Attention, RotaryVectorAttention, SinusoidAttention):
        torch.manual_seed(0)
        attention = kind(width=8, heads=2).double()
        cache = torch.zeros(2, 9, 16).double()
        parts = [attention.extend(x()[:, :4], cache, 0)]
        parts += [attention.extend(x()[:, i : i + 1], cache, i) for i in range(4, 9)]
        torch.testing.assert_close(torch.cat(parts, 1), attention(x()))


@torch.no_grad()
def test_the_ring_is_a_naive_loop_over_the_last_frames():
    torch.manual_seed(0)
    attention = RingAttention(width=8, heads=2, lookback=3).double()
    q, k, v = (part.unflatten(-1, (2, 4)) for part in attention.qkv(x()).chunk(3, -1))
    rows = []
    for t in range(9):
        heads = []
        for h in range(2):
            seen = range(max(0, t - 3), t + 1)
            scores = [(q[0, t, h] @ k[0, s, h]) / 2 + attention.bias[h, 3 - (t - s)] for s in seen]
            weights = torch.softmax(torch.stack(scores), 0)
            heads.append(sum(w * v[0, s, h] for w, s in zip(weights, seen, strict=True)))
        rows.append(attention.proj(torch.cat(heads)))
    torch.testing.assert_close(attention(x())[0], torch.stack(rows))


def test_rotation_keeps_lengths_and_tells_positions_from_the_start():
    rotated = rotate_pairs(x(), 0)
    torch.testing.assert_close(rotated.norm(dim=-1), x().norm(dim=-1))
    torch.testing.assert_close(rotated[:, 0], x()[:, 0])
    torch.testing.assert_close(rotate_pairs(x()[:, 4:], 4), rotated[:, 4:])
    torch.testing.assert_close(sinusoids(x()[:, 4:], 4), sinusoids(x(), 0)[4:])
