"""A turn that is too fast takes the frames it needs; others are not touched."""

import numpy as np

from echoavatar.motion.stages.pose import Pose
from echoavatar.motion.stages.speed_limit import SpeedLimit

FPS = 30.0
MOST = 1000 / FPS  # degrees


def pose(degrees) -> Pose:
    """Two joints: one turned about X by these angles, frame by frame, one at rest."""
    half = np.radians(np.asarray(degrees, float)) / 2
    rotations = np.zeros((1, len(half), 2, 4), np.float32)
    rotations[..., 0] = 1
    rotations[0, :, 0, 0], rotations[0, :, 0, 1] = np.cos(half), np.sin(half)
    return Pose(rotations, np.zeros((1, len(half), 3), np.float32), FPS)


def angles(shown: Pose) -> np.ndarray:
    return np.degrees(2 * np.arctan2(shown.rotations[0, :, 0, 1], shown.rotations[0, :, 0, 0]))


def run(pieces, active=True):
    limit = SpeedLimit(2)
    state, found = limit.init_state(1), []
    for piece in pieces:
        shown = pose(piece)
        limit.step(shown, state, np.array([active]))
        found.append(angles(shown))
    return np.concatenate(found)


def test_a_flick_takes_as_long_as_it_may_and_arrives():
    flick = [0.0, 0.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0]
    shown = run([flick])
    np.testing.assert_allclose(shown, [0, 0, MOST, 2 * MOST, 80, 80, 80, 80], atol=1e-2)


def test_what_is_slow_enough_stays_as_it_is():
    slow = np.linspace(0, 7 * 0.9 * MOST, 8)
    given = pose(slow)
    before = given.rotations.copy()
    SpeedLimit(2).step(given, SpeedLimit(2).init_state(1), np.array([True]))
    np.testing.assert_array_equal(given.rotations, before)


def test_chunks_are_as_one_and_a_new_session_begins_anywhere():
    path = [50.0, 50.0, 150.0, 150.0, 150.0, 20.0, 20.0, 20.0]
    np.testing.assert_allclose(run([path[:3], path[3:]]), run([path]), atol=1e-3)
    assert run([path])[0] == run([path], active=False)[0]
    np.testing.assert_allclose(run([path], active=False), path, atol=1e-3)
