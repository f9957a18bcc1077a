import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import (
    APPLE_NAMES,
    ARKIT_NAMES,
    LIVE_LINK_NAMES,
    VRM_NAMES,
    mouth_opening,
    reorder,
    to_live_link,
    to_vrm,
)


def face(**channels: float) -> np.ndarray:
    return reorder(np.tile(np.array([*channels.values()], np.float32), (3, 1)), tuple(channels))


def test_orders_are_the_known_ones():
    """Live Link has the right of jaw and mouth first, Apple the left; the alphabet begins with the brows."""
    assert len(set(ARKIT_NAMES)) == 52
    assert [ARKIT_NAMES.index(n) for n in ("jawRight", "jawLeft", "mouthRight", "mouthLeft")] == [15, 16, 21, 22]
    assert [APPLE_NAMES.index(n) for n in ("jawLeft", "jawRight", "mouthLeft", "mouthRight")] == [15, 16, 21, 22]
    assert (sorted(ARKIT_NAMES)[0], sorted(ARKIT_NAMES)[-1]) == ("browDownLeft", "tongueOut")
    assert (len(LIVE_LINK_NAMES), LIVE_LINK_NAMES[52]) == (61, "headYaw")


def test_reordering_goes_by_name_and_back():
    curves = np.random.default_rng(0).random((4, 52)).astype(np.float32)
    apple = reorder(curves, ARKIT_NAMES, APPLE_NAMES)
    assert np.array_equal(apple[:, 15], curves[:, 16])
    assert np.array_equal(reorder(apple, APPLE_NAMES), curves)
    with pytest.raises(MotionError, match="52 columns"):
        reorder(curves, ARKIT_NAMES[:51])


def test_live_link_eyes_follow_the_look_curves():
    """Both eyes turn to the character's left: the left one outwards, the right one inwards, by equal angles."""
    columns = dict(zip(LIVE_LINK_NAMES, to_live_link(face(eyeLookOutLeft=0.5, eyeLookInRight=0.5)).T, strict=True))
    np.testing.assert_allclose(columns["leftEyeYaw"], -0.3, rtol=1e-6)
    np.testing.assert_allclose(columns["rightEyeYaw"], -0.3, rtol=1e-6)
    assert columns["headYaw"].max() == 0


@pytest.mark.parametrize(
    ("vowel", "channels"),
    [
        ("aa", {"jawOpen": 0.6}),
        ("ou", {"mouthPucker": 0.7, "jawOpen": 0.15}),
        ("oh", {"jawOpen": 0.4, "mouthFunnel": 0.6}),
        ("ee", {"mouthStretchLeft": 0.5, "mouthStretchRight": 0.5, "jawOpen": 0.25}),
    ],
)
def test_vowels_are_told_apart_for_vrm(vowel, channels):
    weights = dict(zip(VRM_NAMES, to_vrm(face(**channels))[0], strict=True))
    assert max(VRM_NAMES[:5], key=lambda name: weights[name]) == vowel
    assert weights[vowel] > 0.3


def test_vrm_at_rest_is_zero_and_a_wink_is_one_sided():
    assert to_vrm(face()).max() == 0
    wink = dict(zip(VRM_NAMES, to_vrm(face(eyeBlinkLeft=1.0))[0], strict=True))
    assert (wink["blink"], wink["blinkLeft"], wink["blinkRight"]) == (0, 1, 0)
    assert to_vrm(np.ones((1, 52), np.float32))[:, :5].sum() <= 1 + 1e-6


def test_closed_lips_count_as_closed_though_the_jaw_is_down():
    np.testing.assert_allclose(mouth_opening(face(jawOpen=0.4, mouthClose=0.3)), 0.1, rtol=1e-5)
    assert mouth_opening(face(jawOpen=0.1, mouthClose=0.3)).max() == 0
