import numpy as np
from scipy.ndimage import correlate1d, maximum_filter1d

from echoavatar.motion.kinematics.windows import weighted_mean, windows


def test_windows_and_means_are_those_of_scipy_with_held_ends() -> None:
    values, weights = np.random.default_rng(0).standard_normal((9, 3)), np.array([1.0, 2.0, 5.0, 2.0, 0.5])
    np.testing.assert_array_equal(windows(values, 11).max(-1), maximum_filter1d(values, 23, axis=0, mode="nearest"))
    wanted = correlate1d(values, weights / weights.sum(), axis=0, mode="nearest")
    np.testing.assert_allclose(weighted_mean(values, weights), wanted, atol=1e-12)
