import pytest
import torch
from tests.models.face.tiny import CONFIG

from echoavatar_lab.models.face.gpt import (
    Attention,
    FaceGpt,
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


def make(memory: str) -> FaceGpt:
    torch.manual_seed(0)
    return FaceGpt(CONFIG.model_copy(update={"memory": memory})).double().eval()


@torch.no_grad()
@pytest.mark.parametrize(("memory", "depth"), [("ring", 23), ("window", 63)])
def test_how_far_back_a_condition_depends_on_motion(memory, depth):
    """Ring: two layers that see 11 frames back each, and itself: 23. Window: all there is."""
    gpt = make(memory)
    motion, sound = torch.randn(1, 63, 52).double(), torch.zeros(1, 63, 16).double()
    before, reached = gpt(motion, sound)[0, -1], 0
    for frame in range(63):
        changed = motion.clone()
        changed[0, frame] += 1
        reached += not torch.equal(gpt(changed, sound)[0, -1], before)
    assert reached == depth


@torch.no_grad()
@pytest.mark.parametrize("memory", ["ring", "window"])
def test_conditions_know_nothing_of_later_frames(memory):
    gpt = make(memory)
    motion, sound = torch.randn(1, 20, 52).double(), torch.randn(1, 20, 16).double()
    whole = gpt(motion, sound)
    torch.testing.assert_close(gpt(motion[:, :12], sound[:, :12]), whole[:, :12])
