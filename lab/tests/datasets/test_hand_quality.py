from dataclasses import replace

import numpy as np
import pytest
import torch
from lab.tests.datasets.samples import SHARED, gesture

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from echoavatar_lab.datasets.hand_quality import hand_scores, hand_states, mend_hands

LEFT = [j for j, name in enumerate(HUMANOID.names) if j in HUMANOID.config.parts["hands"] and name.startswith("left")]


def trembling(motion: Motion, degrees: float) -> Motion:
    """White noise on the left fingers."""
    noise = torch.randn(motion.frames, len(LEFT), 3, generator=torch.Generator().manual_seed(0))
    rotations = motion.rotations.copy()
    own = torch.from_numpy(rotations[:, LEFT])
    rotations[:, LEFT] = quaternion_multiply(own, quaternion_from_axis_angle(noise * np.radians(degrees))).numpy()
    return replace(motion, rotations=rotations)


def test_static_trembling_and_good_hands_are_distinguished():
    assert hand_states(gesture()) == {"left": "good", "right": "good"}
    assert hand_states(gesture(fingers=0.0)) == {"left": "static", "right": "static"}
    for degrees in (2.0, 8.0):
        assert hand_states(trembling(gesture(), degrees)) == {"left": "erratic", "right": "good"}


def test_fingers_bent_too_far_are_erratic():
    assert hand_states(gesture(fingers=3.0))["left"] == "erratic"


def test_white_noise_scores_as_the_docstring_says():
    """Two independent steps a frame apart differ by about sqrt(3) of one: 3 / (2 sqrt 3) = 0.87."""
    noise = torch.randn(4000, 2, 3, generator=torch.Generator().manual_seed(0)) * 0.01
    from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle

    assert hand_scores(matrix_from_axis_angle(noise), 30.0).tremble == pytest.approx(0.87, abs=0.02)


def test_only_bad_hands_get_new_fingers():
    motion = trembling(gesture(), 6.0)
    mended, sides = mend_hands(motion, hand_states(motion), 3, is_all=False)
    assert sides == ["left"]
    others = [j for j in range(HUMANOID.joints) if j not in LEFT]
    assert np.array_equal(mended.rotations[:, others], motion.rotations[:, others])
    assert hand_states(mended) == {"left": "good", "right": "good"}
    untouched, none = mend_hands(gesture(), {"left": "good", "right": "good"}, 3, is_all=False)
    assert none == []
    assert np.array_equal(untouched.rotations, gesture().rotations)


def test_the_seed_decides_the_new_fingers():
    flat = gesture(2.0, fingers=0.0)
    states = hand_states(flat)
    one, sides = mend_hands(flat, states, 1, is_all=False)
    again, _ = mend_hands(flat, states, 1, is_all=False)
    other, _ = mend_hands(flat, states, 2, is_all=False)
    assert sides == ["left", "right"]
    assert np.array_equal(one.rotations, again.rotations)
    assert not np.allclose(one.rotations, other.rotations, atol=1e-3)


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_a_real_speakers_hands_are_good():
    motion = read_bvh(SHARED / "zeroeggs_cc_by_nc_nd" / "067_Speech_2_x_1_0.bvh")
    assert hand_states(motion) == {"left": "good", "right": "good"}
