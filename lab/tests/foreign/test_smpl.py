import pickle  # noqa: TID251  # to make what must be refused and what must be read
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, write_beat2

from echoavatar.errors import MotionError
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar_lab.foreign.smpl import read_smpl_pickle, read_smplx, rest_joints

ARMS = ("leftLowerArm", "leftHand", "rightLowerArm", "rightHand", "head", "leftIndexDistal", "rightThumbDistal")


def test_the_skeleton_has_the_55_joints_in_their_order():
    rig = skeleton()
    assert rig.joints == 55
    assert [rig.names[j] for j in (0, 15, 20, 22, 25, 37, 39, 40, 54)] == [
        "pelvis",
        "head",
        "left_wrist",
        "jaw",
        "left_index1",
        "left_thumb1",
        "left_thumb3",
        "right_index1",
        "right_thumb3",
    ]
    assert [rig.names[rig.parents[j]] for j in (25, 28, 31, 34, 37, 52)] == ["left_wrist"] * 5 + ["right_wrist"]
    assert set(rig.config.vrm) == set(HUMANOID.names)


@pytest.mark.parametrize("is_z_up", [False, True])
def test_axis_angles_become_the_motion_they_were(tmp_path, is_z_up):
    """The sample is `gesture` in SMPL-X's joint order: after reading and retargeting, joints must be in place."""
    motion = read_smplx(write_beat2(tmp_path, "1_a_0", is_z_up=is_z_up))
    assert motion.fps == 30
    wanted, found = gesture().pose().positions, retarget(motion).pose().positions
    joints = HUMANOID.indices(ARMS)
    assert np.linalg.norm(wanted[:, joints] - found[:, joints], axis=-1).max() < 0.01


def test_the_floor_is_under_the_feet(tmp_path):
    """SMPL-X's origin is near the chest; the sample's is 1.2 m over its pelvis."""
    places = read_smplx(write_beat2(tmp_path, "1_a_0")).pose().positions
    rig = skeleton()
    ankles = rig.indices(("left_ankle", "right_ankle"))
    assert float(places[:, ankles, 1].mean()) == pytest.approx(float(rig.rest_positions[ankles, 1].mean()), abs=2e-3)


def body_model(path, **changes):
    """A body model with one vertex per joint: the template is our skeleton, one shape scales the body by 1.1."""
    rest = skeleton().rest_positions.astype(np.float64)
    shapes = np.zeros((55, 3, 20))
    shapes[..., 0] = rest * 0.1
    arrays = {"v_template": rest - [0, 1, 0], "shapedirs": shapes, "J_regressor": np.eye(55)} | changes
    np.savez(path, **arrays)
    return path


def test_a_body_model_gives_the_speakers_own_joints(tmp_path):
    path = body_model(tmp_path / "SMPLX_NEUTRAL.npz")
    rest = skeleton().rest_positions
    np.testing.assert_allclose(rest_joints(path, np.array([1.0])), 1.1 * rest - [0, 1, 0], atol=1e-6)
    poses = write_beat2(tmp_path, "1_a_0")
    with np.load(poses) as stored:
        arrays = dict(stored) | {"betas": np.array([1.0, *np.zeros(299)])}
    np.savez(poses, **arrays)
    motion = read_smplx(poses, body_model=path)
    ours, theirs = skeleton(), motion.skeleton
    elbow = ours.index("left_elbow")
    np.testing.assert_allclose(theirs.offsets[elbow], 1.1 * ours.offsets[elbow], atol=1e-6)
    toes = theirs.indices(("left_foot", "right_foot"))
    assert float(theirs.rest_positions[toes, 1].min()) == pytest.approx(
        float(ours.rest_positions[toes, 1].min()), abs=1e-5
    )


def test_an_invalid_body_model_is_refused(tmp_path):
    (tmp_path / "x.npz").write_bytes(b"no model")
    with pytest.raises(MotionError, match="not an SMPL-X body model"):
        rest_joints(tmp_path / "x.npz", np.zeros(10))
    with pytest.raises(MotionError, match="55 joints"):
        rest_joints(body_model(tmp_path / "y.npz", J_regressor=np.eye(55)[:24]), np.zeros(10))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"poses": np.zeros((4, 71))}, r"poses \(4, 71\)"),
        ({"trans": np.full((4, 3), np.nan)}, "frame 0: values that are not finite"),
        ({"poses": np.outer([0, np.pi, 0, np.pi], np.eye(165)[0])}, "the body does not stand"),
        ({"poses": np.array([{}], dtype=object)}, "cannot be read as npz"),
    ],
)
def test_bad_files_are_named_with_what_is_wrong(tmp_path, changes, complaint):
    arrays = {"poses": np.zeros((4, 165)), "trans": np.zeros((4, 3))} | changes
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(MotionError, match=f"a.npz.*{complaint}"):
        read_smplx(tmp_path / "a.npz")


def test_torn_and_missing_files_are_named(tmp_path):
    whole = write_beat2(tmp_path, "1_a_0").read_bytes()
    (tmp_path / "torn.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MotionError, match="torn.npz cannot be read"):
        read_smplx(tmp_path / "torn.npz")
    with pytest.raises(MotionError, match="does not exist"):
        read_smplx(tmp_path / "gone.npz")


class Runs:
    """What a pickle with code in it looks like."""

    def __reduce__(self):
        return (print, ("this must never run",))


def write_edge(path: Path, poses: np.ndarray, trans: np.ndarray, **others: object) -> Path:
    stored = {"smpl_poses": poses, "smpl_trans": trans, "full_pose": np.zeros((len(poses), 24, 3), np.float32)}
    path.write_bytes(pickle.dumps(stored | others, protocol=4))
    return path


@pytest.fixture
def beat2(tmp_path: Path) -> tuple[Path, np.ndarray, np.ndarray]:
    """Known motion as SMPL-X, its first 24 joints as SMPL has them, and the places, Z up as EDGE has them."""
    path = write_beat2(tmp_path, "1_a_0", is_z_up=True)
    with np.load(path) as stored:
        return path, stored["poses"][:, :72].astype(np.float32), stored["trans"].astype(np.float32)


def test_edges_file_is_the_motion_it_was(tmp_path: Path, beat2) -> None:
    path, poses, trans = beat2
    found, wanted = read_smpl_pickle(write_edge(tmp_path / "test_song.pkl", poses, trans)), read_smplx(path)
    assert found.fps == 30
    np.testing.assert_allclose(found.rotations[:, :22], wanted.rotations[:, :22], atol=1e-5)
    np.testing.assert_allclose(found.rotations[:, 22:, 0], 1)  # jaw, eyes and fingers are straight
    np.testing.assert_allclose(np.diff(found.root, axis=0), np.diff(wanted.root, axis=0), atol=1e-5)


def test_aist_is_scaled_and_at_60(tmp_path: Path, beat2) -> None:
    _, poses, trans = beat2
    plain = read_smpl_pickle(write_edge(tmp_path / "a.pkl", poses, trans))
    scaled = write_edge(tmp_path / "b.pkl", poses, trans * 90, smpl_scaling=np.array([90.0]))
    found = read_smpl_pickle(scaled)
    assert found.fps == 60
    np.testing.assert_allclose(found.root, plain.root, atol=1e-4)


def test_a_pickle_with_code_is_refused_by_name(tmp_path: Path, beat2, capsys) -> None:
    _, poses, trans = beat2
    path = write_edge(tmp_path / "evil.pkl", poses, trans, extra=Runs())
    with pytest.raises(MotionError, match=r"evil\.pkl is refused: it would run builtins\.print"):
        read_smpl_pickle(path)
    assert "never run" not in capsys.readouterr().out


def test_what_is_no_motion_is_named(tmp_path: Path, beat2) -> None:
    _, poses, trans = beat2
    poses[7, 3] = np.nan
    with pytest.raises(MotionError, match=r"a\.pkl, frame 7: .*not finite"):
        read_smpl_pickle(write_edge(tmp_path / "a.pkl", poses, trans))
    with pytest.raises(MotionError, match=r"a\.pkl: poses .* SMPL has \(t, 72\)"):
        read_smpl_pickle(write_edge(tmp_path / "a.pkl", poses[:, :69], trans))
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"q": poses}))
    with pytest.raises(MotionError, match=r"a\.pkl has no array 'smpl_poses' \(found: q\)"):
        read_smpl_pickle(tmp_path / "a.pkl")
    (tmp_path / "a.pkl").write_bytes(b"nothing")
    with pytest.raises(MotionError, match=r"a\.pkl is damaged"):
        read_smpl_pickle(tmp_path / "a.pkl")
    with pytest.raises(MotionError, match="does not exist"):
        read_smpl_pickle(tmp_path / "none.pkl")
