import numpy as np

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.rigging import smooth, strongest, weigh

REST = HUMANOID.rest_positions.numpy().astype(float)


def leader(piece: str, point: tuple[float, float, float]) -> str:
    return HUMANOID.names[int(weigh(piece, np.asarray([point], float))[0].argmax())]


def test_limbs_follow_their_own_bones() -> None:
    assert leader("jacket", (0.30, 1.40, 0.03)) == "leftUpperArm"
    assert leader("jacket", (-0.55, 1.40, 0.03)) == "rightLowerArm"
    assert leader("trousers", (0.10, 0.70, 0.07)) == "leftUpperLeg"
    assert leader("trousers", (-0.10, 0.30, 0.05)) == "rightLowerLeg"
    assert leader("shoes", (0.10, 0.03, 0.17)) == "leftToes"
    assert leader("skin", (0.0, 1.485, 0.075)) == "head"
    assert leader("skin", (0.0, 1.44, -0.08)) in ("neck", "upperChest")


def test_a_fingertip_follows_its_finger_alone() -> None:
    for side in ("left", "right"):
        for finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
            distal = HUMANOID.index(f"{side}{finger}Distal")
            way = REST[distal] - REST[HUMANOID.parents[distal]]
            tip = REST[distal] + way / np.linalg.norm(way) * 0.012
            weights = weigh("hands", tip[None])[0]
            assert weights[distal] > 0.95
            np.testing.assert_allclose(weights.sum(), 1)


def test_sides_never_mix() -> None:
    p = np.random.default_rng(0).normal(size=(200, 3)) * 0.05 + [0.15, 0.6, 0]
    weights = weigh("trousers", p[p[:, 0] > 0.03])
    right = [i for i, name in enumerate(HUMANOID.names) if name.startswith("right")]
    assert weights[:, right].max() < 0.02


def test_smoothing_keeps_sums_and_strongest_keeps_four() -> None:
    p = np.random.default_rng(0).normal(size=(300, 3)) * 0.1 + [0.2, 1.35, 0]
    weights = smooth(weigh("jacket", p), p, passes=3)
    np.testing.assert_allclose(weights.sum(1), 1)
    joints, shares = strongest(weights)
    assert joints.shape == shares.shape == (300, 4)
    np.testing.assert_allclose(shares.sum(1), 1, atol=1e-6)
