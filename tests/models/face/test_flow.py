import pytest
import torch

from echoavatar.models.face.flow import FlowHead, euler_levels, face_noise, normal_noise
from echoavatar_lab.models.face.train import add_noise

SEEDS = torch.arange(50)


def draw(start: int, count: int, hold: int) -> torch.Tensor:
    return face_noise(SEEDS, torch.full((50,), start), count=count, channels=20, hold=hold)


def test_it_is_standard_normal_and_independent():
    noise = normal_noise(SEEDS, torch.zeros(50, dtype=torch.int64), count=20, channels=20)
    assert noise.shape == (50, 20, 20)
    assert abs(noise.mean()) < 0.03
    assert abs(noise.std() - 1) < 0.02
    assert abs((noise > 1.645).double().mean() - 0.05) < 0.006
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < 0.03
    assert abs((noise[1:] * noise[:-1]).mean()) < 0.03


@pytest.mark.parametrize("hold", [1, 5, 16])
def test_frames_are_told_by_their_number_alone(hold):
    whole = draw(0, 24, hold)
    parts = torch.cat([draw(start, 8, hold) for start in (0, 8, 16)], 1)
    torch.testing.assert_close(parts, whole, atol=0, rtol=0)


def test_held_noise_turns_slowly_and_keeps_its_strength():
    """Half way between two draws the weights are cos 45 and sin 45 degrees: unit variance."""
    noise = draw(0, 33, 16)
    assert abs(noise[:, 8].std() - 1) < 0.06
    step = (noise[:, 1:] - noise[:, :-1]).square().mean().sqrt()
    assert step < 0.12  # a quarter turn in 16 frames is about 0.1 per frame; independent draws differ by 1.41


def make(split: bool = False) -> FlowHead:
    torch.manual_seed(0)
    return FlowHead(channels=5, condition=6, width=8, blocks=2, split=split).double()


def test_a_head_that_knows_the_face_arrives_there():
    """If every prediction is the face, Euler steps end at it exactly, whatever the noise."""
    head, face = make(), torch.randn(3, 5).double()
    head.clean = lambda noisy, steering: face[:, None].expand(-1, 2, -1)
    out = head.sample(torch.randn(3, 2, 6).double(), torch.randn(3, 5).double(), head.schedule(3), guidance=2.0)
    torch.testing.assert_close(out, face)


def test_guidance_goes_beyond_the_prediction_with_sound():
    """With one step the result is the guided prediction: u + 2 (c - u)."""
    head = make()
    both = torch.randn(3, 2, 5).double()
    head.clean = lambda noisy, steering: both
    out = head.sample(torch.zeros(3, 2, 6).double(), torch.zeros(3, 5).double(), head.schedule(1), guidance=2)
    torch.testing.assert_close(out, 2 * both[:, 1] - both[:, 0])


@torch.no_grad()
@pytest.mark.parametrize("split", [False, True])
def test_steps_with_steering_at_hand_are_the_plain_function(split):
    """Two Euler steps by hand, each branch apart."""
    head = make(split)
    condition, x = torch.randn(4, 2, 6).double(), torch.randn(4, 5).double()
    ours = head.sample(condition, x, head.schedule(2), guidance=2.0)
    for time, level, following in ((1000, 1.0, 0.001), (1, 0.001, 0.0)):
        without, with_sound = (head(x, torch.full((4,), time), condition[:, i]) for i in range(2))
        face = without + 2 * (with_sound - without)
        x = x + (following - level) * (x - face) / level
    torch.testing.assert_close(ours, x, atol=1e-5, rtol=0)


def test_noise_lies_on_the_straight_path():
    clean, noise = torch.zeros(2, 3), torch.ones(2, 3)
    path = add_noise(clean, noise, torch.tensor([1000, 250]))
    torch.testing.assert_close(path, torch.tensor([[1.0] * 3, [0.25] * 3]))


def test_levels_end_at_zero():
    times, levels = euler_levels(4)
    assert times == [1000, 667, 334, 1]
    assert levels == [1.0, 0.667, 0.334, 0.001, 0.0]
