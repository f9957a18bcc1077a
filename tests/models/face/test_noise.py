import numpy as np
import pytest

from echoavatar.models.face.noise import euler_levels, face_noise, normal_noise

SEEDS = np.arange(50)


def draw(start: int, count: int, hold: int) -> np.ndarray:
    return face_noise(SEEDS, np.full(50, start), count=count, channels=20, hold=hold)


def test_it_is_standard_normal_and_independent():
    noise = normal_noise(SEEDS, np.zeros(50, np.int64), count=20, channels=20)
    assert noise.shape == (50, 20, 20)
    assert abs(noise.mean()) < 0.03
    assert abs(noise.std() - 1) < 0.02
    assert abs((noise > 1.645).mean() - 0.05) < 0.006
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < 0.03
    assert abs((noise[1:] * noise[:-1]).mean()) < 0.03


@pytest.mark.parametrize("hold", [1, 5, 16])
def test_frames_are_told_by_their_number_alone(hold):
    parts = np.concatenate([draw(start, 8, hold) for start in (0, 8, 16)], 1)
    np.testing.assert_array_equal(parts, draw(0, 24, hold))


def test_held_noise_turns_slowly_and_keeps_its_strength():
    """Half way between two draws the weights are cos 45 and sin 45 degrees: unit variance."""
    noise = draw(0, 33, 16)
    assert abs(noise[:, 8].std() - 1) < 0.06
    step = np.sqrt(np.square(np.diff(noise, axis=1)).mean())
    assert step < 0.12  # a quarter turn in 16 frames is about 0.1 per frame; independent draws differ by 1.41


def test_levels_end_at_zero():
    times, levels = euler_levels(4)
    assert times == [1000, 667, 334, 1]
    assert levels == [1.0, 0.667, 0.334, 0.001, 0.0]
    assert euler_levels(1) == ([1000], [1.0, 0.0])
