import json

import numpy as np

from echoavatar.motion.action_overlay import Hands, Overlay, apply_overlay, bridge
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk


def nod(size: float) -> Overlay:
    """Two chunks in which the head pitches by `size` from the first frame to the last."""
    rotation_vectors = np.zeros((16, 1, 3), np.float32)
    rotation_vectors[:, 0, 0] = np.linspace(size / 16, size, 16)
    return Overlay(("head",), rotation_vectors)


def test_it_comes_back_from_json_to_a_milliradian() -> None:
    again = Overlay.from_json(nod(0.3).to_json())
    assert again.joints == ("head",)
    np.testing.assert_allclose(again.rotation_vectors, nod(0.3).rotation_vectors, atol=5e-4)


def test_turns_are_added_to_the_joint_and_to_no_other() -> None:
    still = np.tile(np.float32([1, 0, 0, 0]), (8, 52, 1))
    shown = apply_overlay(MotionChunk(still, np.zeros((8, 3), np.float32)), nod(0.4).chunk(1).scaled(0.5), HUMANOID)
    head = HUMANOID.index("head")
    np.testing.assert_allclose(2 * np.arcsin(shown.rotations[:, head, 1]), np.linspace(0.1125, 0.2, 8), rtol=1e-5)
    np.testing.assert_array_equal(np.delete(shown.rotations, head, 1), np.delete(still, head, 1))


def test_chunks_that_do_not_meet_are_bridged() -> None:
    first, second = nod(0.4).chunk(0), nod(0.4).chunk(1)
    back = bridge(second, first)  # a held action repeats
    after = bridge(second, None)  # an action was cut short
    assert back is not None
    assert after is not None
    for overlay, end in ((back, first.rotation_vectors[-1, 0, 0]), (after, 0)):
        path = np.concatenate([second.rotation_vectors[-1:, 0, 0], overlay.rotation_vectors[:, 0, 0]])
        assert np.abs(np.diff(path)).max() < 0.12
        np.testing.assert_allclose(path[-1], end, atol=1e-6)
    assert bridge(None, None) is None


def palm(angle: float, share: float, frames: int = 16) -> Overlay:
    """A left hand that is turned by `angle` about x and takes the place of the motion's own as far as `share`."""
    turned = np.tile(np.float32([np.cos(angle / 2), np.sin(angle / 2), 0, 0]), (frames, 1, 1))
    return Overlay((), np.zeros((frames, 0, 3), np.float32), Hands(("leftHand",), turned, np.full((frames, 1), share)))


def shown(overlay: Overlay) -> np.ndarray:
    """The left hand's angle about x where the motion's own is 0.4."""
    own = np.tile(np.float32([1, 0, 0, 0]), (8, 52, 1))
    own[:, HUMANOID.index("leftHand")] = np.float32([np.cos(0.2), np.sin(0.2), 0, 0])
    made = apply_overlay(MotionChunk(own, np.zeros((8, 3), np.float32)), overlay, HUMANOID).rotations
    hand = HUMANOID.index("leftHand")
    np.testing.assert_array_equal(np.delete(made, hand, 1), np.delete(own, hand, 1))
    return 2 * np.arcsin(made[:, hand, 1])


def test_hands_take_the_place_of_the_motions_own_as_far_as_their_share() -> None:
    for share, angle in ((1.0, 1.0), (0.5, 0.7), (0.0, 0.4)):
        np.testing.assert_allclose(shown(palm(1.0, share).chunk(1)), angle, atol=1e-5)
    np.testing.assert_allclose(shown(palm(1.0, 1.0).scaled(0.5).chunk(0)), 0.7, atol=1e-5)
    np.testing.assert_allclose(shown(palm(1.0, 1.0).scaled(2.0).chunk(0)), 1.0, atol=1e-5)


def test_hands_come_back_from_json() -> None:
    hands = palm(1.0, 0.25).hands
    stored = json.loads(json.dumps(hands.to_json()))
    assert len(stored["joints"]["leftHand"]) == 3  # a rotation that does not change is stored once
    again = Overlay.from_json({}, stored)
    np.testing.assert_allclose(again.hands.rotations, hands.rotations, atol=1e-3)
    np.testing.assert_allclose(again.hands.shares, hands.shares, atol=1e-3)
    assert len(again.rotation_vectors) == 16


def test_hands_that_do_not_meet_are_bridged() -> None:
    """From one clip's hands to another's, to none, and from none: the shown angle moves without a jump."""
    one, other = palm(1.0, 1.0).chunk(0), palm(-0.6, 1.0).chunk(0)
    for before, now, start, end in ((one, other, 1.0, -0.6), (one, None, 1.0, 0.4), (None, one, 0.4, 1.0)):
        joined = bridge(before, now)
        assert joined is not None
        path = shown(joined)
        np.testing.assert_allclose(path[-1], end, atol=1e-3)
        assert np.abs(np.diff(np.concatenate([[start], path]))).max() < 0.25 * abs(end - start)
