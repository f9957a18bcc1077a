import numpy as np
import pytest
from tests.golden import metric_inputs
from tests.motion.kinematics.samples import swaying

from echoavatar_lab.evaluation.metrics.dance_features import SMPL, geometric, kinetic, smpl_positions

# of 300 frames of `motion_a24_60fps`, three times as large: google/aistplusplus_api, features/manual.py, computed once
GEOMETRIC = [0.2508, 0.2977, 0, 0, 0.1773, 0.1773, 1, 1, 0.2207, 0.2676, 0.2508, 0.3211, 0.612, 0.6054, 0.0502, 0]
GEOMETRIC += [0, 1, 0, 1, 1, 0.0736, 0.3478, 1, 1, 1, 1, 1, 0, 0, 0, 0.4515]


def test_geometric_features_are_those_of_aist() -> None:
    positions = metric_inputs()["motion_a24_60fps"][:300].astype(np.float64) * 3
    assert geometric(positions) == pytest.approx(GEOMETRIC, abs=6e-5)


def test_a_steady_glide_has_speed_and_no_acceleration() -> None:
    path = np.zeros((60, 24, 3))
    path[..., 0], path[..., 1] = np.arange(60)[:, None] * 0.02, np.arange(60)[:, None] * 0.01
    flat, up, bend = kinetic(path, 60, is_published=False).reshape(24, 3).T
    assert flat == pytest.approx(1.2**2)
    assert up == pytest.approx(0.6**2)
    assert bend == pytest.approx(0, abs=1e-8)
    assert kinetic(path, 60).reshape(24, 3)[:, 2].min() > 1000  # the published bracket


def test_smpls_joints_are_ours_by_name() -> None:
    assert len(set(SMPL)) == 24
    motion = swaying(40)
    places = motion.pose().positions
    found = smpl_positions(places)
    assert found[0, 0] == pytest.approx(0)
    left, right = (found[0, SMPL.index(f"{side}UpperArm"), 0] for side in ("left", "right"))
    assert left > 0.1 > -0.1 > right
    assert SMPL.index("leftUpperArm") == 16
    assert SMPL.index("head") == 15
