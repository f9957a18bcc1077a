import pytest
import torch

from echoavatar_lab.training import TrainingConfig


def test_the_rate_warms_up_then_follows_its_schedule():
    """Peak 1, two steps of warm-up: a half, then the whole; then what each schedule says half-way of ten steps."""
    base = TrainingConfig(steps=10, learning_rate=1.0, warmup=2, final_rate=0.1)
    assert base.rate_at(0) == pytest.approx(0.5)
    assert base.rate_at(5) == pytest.approx(0.55)  # 0.1 + 0.9 / 2
    assert base.rate_at(10) == pytest.approx(0.1)
    constant = base.model_copy(update={"schedule": "constant"})
    assert [constant.rate_at(step) for step in (1, 5, 10)] == [1, 1, 1]
    drops = base.model_copy(update={"schedule": "step", "decay_at": (0.5, 0.8), "decay_factor": 0.1})
    assert [drops.rate_at(step) for step in (1, 4, 5, 8)] == pytest.approx([1, 1, 0.1, 0.01])


def test_the_clock_may_say_how_much_is_done():
    config = TrainingConfig(steps=1000, learning_rate=1.0, warmup=0, final_rate=0.0)
    assert config.rate_at(1, done=0.5) == pytest.approx(0.5)


def test_noise_is_of_seed_step_and_salt_alone():
    config = TrainingConfig(seed=3)

    def drawn(*args):
        return torch.rand(4, generator=config.noise(*args)).tolist()

    assert drawn(7) == drawn(7)
    assert drawn(7) != drawn(8) != drawn(7, 500_009)
