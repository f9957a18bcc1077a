import numpy as np

from echoavatar.motion.action_overlay import Overlay, apply_overlay, bridge
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
