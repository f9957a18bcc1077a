import numpy as np

from echoavatar.motion.kinematics.easing import falloff, smootherstep


def test_a_step_has_no_speed_and_no_acceleration_at_its_ends() -> None:
    share, step = np.array([0.0, 0.5, 1.0]), 1e-4
    before, value, after = (smootherstep(share + aside) for aside in (-step, 0.0, step))
    np.testing.assert_array_equal(value, share)
    np.testing.assert_allclose((after - before) / (2 * step), [0, 1.875, 0], atol=1e-6)
    np.testing.assert_allclose((after - 2 * value + before) / step**2, 0, atol=1e-4)


def test_a_falloff_is_whole_up_to_the_near_end_and_gone_from_the_far_one() -> None:
    assert falloff(np.array([0.0, 1.0, 2.0, 3.0, 4.0]), 1.0, 3.0).tolist() == [1, 1, 0.5, 0, 0]
