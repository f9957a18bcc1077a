import pytest
import torch

from echoavatar_lab.models.face.flow import FlowHead
from echoavatar_lab.models.face.train import add_noise


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
