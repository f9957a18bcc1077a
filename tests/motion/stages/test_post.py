"""The stages behind the decoder together: against plain arithmetic, and the laws of streaming."""

import numpy as np
import pytest
import torch
from tests.laws.cases import gestures
from tests.motion.stages.poses import cut

from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics, to_features
from echoavatar.motion.kinematics.features import from_features
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionBatch
from echoavatar.motion.stages.post import POST_STAGES, SWITCHES, Post, PostState
from echoavatar.motion.stages.smoother import DELAY


def run(
    post: Post, features: np.ndarray, state: PostState | None = None, active: np.ndarray | None = None
) -> np.ndarray:
    """(b, t, 52 x 4 + 3): rotations and root of any number of chunks."""
    rows = len(features)
    state = state or post.init_state(rows)
    active = np.ones(rows, np.bool_) if active is None else active
    parts = []
    for part in cut(features):
        parts.append(flat(post.step(part, state, active)))
    return np.concatenate(parts, 1)


def drawn(rows: int, frames: int, seed: int) -> np.ndarray:
    return gestures(rows, frames, torch.Generator().manual_seed(seed)).numpy()


def flat(motion: MotionBatch) -> np.ndarray:
    return np.concatenate([motion.rotations.reshape(*motion.root.shape[:2], -1), motion.root], 2)


def test_without_smoothing_upper_body_rotations_are_what_was_decoded() -> None:
    """Outside witness of unpacking: spine, head and fingers go through no stage but smoother and stillness."""
    post = Post(HUMANOID, stages=set(SWITCHES) - {"stillness"})
    post._smoother._stiffness = 0.0
    features = drawn(2, 8, 0)
    shown = run(post, features)[..., : 52 * 4].reshape(2, 8, 52, 4)
    decoded = from_features(HUMANOID, features).rotations
    untouched = HUMANOID.indices(["hips", "spine", "chest", "neck", "head", "leftIndexProximal"])
    np.testing.assert_allclose(
        matrix_from_quaternion(shown)[:, DELAY:, untouched], decoded[:, :-DELAY, untouched], atol=1e-5, rtol=0
    )
    assert (shown[..., 0] >= 0).all()


def test_one_session_is_not_changed_by_its_neighbours() -> None:
    """To the last bit, wherever it sits."""
    features = drawn(9, 24, 2)
    together = run(Post(HUMANOID), features)
    for row in (0, 4, 8):
        assert np.array_equal(run(Post(HUMANOID), features[row : row + 1])[0], together[row])


def test_planted_feet_stand() -> None:
    """Bodies whose feet never leave the floor: after half a second no ball moves by over 0.1 mm a frame."""
    features = drawn(1, 96, 1)
    legs = HUMANOID.indices([s + b for s in ("left", "right") for b in ("UpperLeg", "LowerLeg", "Foot")])
    frames = from_features(HUMANOID, features)
    rotations = frames.rotations.copy()
    rotations[:, :, legs] = matrix_from_axis_angle(np.array([-0.2, 0.4, -0.2] * 2)[:, None] * np.array([1.0, 0.0, 0.0]))
    rotations[:, :, 0] = np.eye(3, dtype=np.float32)
    features = to_features(HUMANOID, rotations, frames.root)
    shown = run(Post(HUMANOID), features)[0]
    matrices = matrix_from_quaternion(shown[:, : 52 * 4].reshape(-1, 52, 4))
    places = forward_kinematics(HUMANOID, matrices, shown[:, -3:]).positions
    balls = places[:, list(HUMANOID.config.feet)[1::2]]
    assert np.linalg.norm(balls[16:] - balls[15:-1], axis=-1).max() < 1e-4


def test_stages_report_in_order() -> None:
    post, stages = Post(HUMANOID), []
    features = drawn(1, 8, 0)
    post.step(features, post.init_state(1), np.ones(1, np.bool_), stages.append)
    assert tuple(stages) == POST_STAGES


@pytest.mark.parametrize("missing", ["fingers", "toes and arms"])
def test_rigs_that_lack_bones_are_carried_through(missing: str) -> None:
    """No fingers: hands are still kept off. No foot joints and no arms known: smoothing and travel alone."""
    config = HUMANOID.config
    if missing == "fingers":
        vrm = {n: j for n, j in config.vrm.items() if not n.endswith(("imal", "iate", "istal", "pal"))}
        rig = Skeleton(config.model_copy(update={"vrm": vrm}))
    else:
        vrm = {n: j for n, j in config.vrm.items() if "Arm" not in n}
        rig = Skeleton(config.model_copy(update={"vrm": vrm, "feet": ()}))
    shown = run(Post(rig), drawn(1, 16, 0))
    assert np.isfinite(shown).all()
    assert shown.shape == (1, 16, 52 * 4 + 3)
