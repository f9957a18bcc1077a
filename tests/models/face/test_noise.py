import pytest
import torch

from echoavatar.models.face.noise import face_noise, normal_noise

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
