import numpy as np

from echoavatar.motion.kinematics.rotations import unit
from echoavatar.motion.kinematics.two_bone import REACH, reach


def legs(count=200, seed=0):
    """Thighs and shins of about 40 cm, bent by up to a right angle about x."""
    generator = np.random.default_rng(seed)
    random = generator.random((count, 5))
    angle, zero = random[:, 0] * 1.5, np.zeros(count)
    hip = np.stack([zero, zero + 0.9, zero], -1)
    knee = hip + np.stack([zero, zero - 0.41, zero], -1)
    ankle = knee + 0.4 * np.stack([zero, -np.cos(angle), -np.sin(angle)], -1)
    target = hip + (random[:, 1:4] - 0.5) * np.array([0.4, 0.2, 0.4]) + np.array([0.0, -0.6, 0.0])
    hinge = np.broadcast_to(np.array([1.0, 0, 0]), (count, 3))
    return hip, knee, ankle, hinge, target


def bent(hip, knee, ankle, first, second):
    middle = hip + (first @ (knee - hip)[..., None])[..., 0]
    return middle, middle + (second @ (ankle - knee)[..., None])[..., 0]


def test_targets_in_reach_are_met():
    hip, knee, ankle, hinge, target = legs()
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    np.testing.assert_allclose(bent(hip, knee, ankle, first, second)[1], target, atol=1e-9, rtol=0)


def test_knees_bend_forward_only():
    """In the plane of the leg, the knee lies ahead (+z) of the line from hip to ankle."""
    hip, knee, ankle, hinge, target = legs()
    target = target * np.array([0.0, 1.0, 0.0]) + hip * np.array([1.0, 0.0, 1.0])
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    middle, _ = bent(hip, knee, ankle, first, second)
    assert float(middle[:, 2].min()) > 0


def test_out_of_reach_is_stretched_towards_it():
    hip, knee, ankle, hinge, _ = legs(3)
    target = hip + np.array([0.0, -2.0, 0.5])
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    _, end = bent(hip, knee, ankle, first, second)
    np.testing.assert_allclose(np.linalg.norm(end - hip, axis=-1), np.full(3, REACH * 0.81), atol=1e-5)
    cosine = (unit(end - hip) * unit(target - hip)).sum(-1)
    np.testing.assert_allclose(cosine, np.ones(3), atol=1e-5)


def test_where_the_ankle_is_already_nothing_turns():
    hip, knee, ankle, hinge, _ = legs()
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=ankle)
    bend = np.linalg.norm(first - np.eye(3), axis=(-1, -2))
    is_clear = np.abs((ankle - knee)[:, 2]) > 0.05  # a straight leg is bent by what REACH leaves
    assert float(bend[is_clear].max()) < 1e-6
    assert float(np.linalg.norm(second - np.eye(3), axis=(-1, -2))[is_clear].max()) < 1e-6
