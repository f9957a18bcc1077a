import pickle  # noqa: TID251  # to make what must be refused and what must be read
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import write_beat2

from echoavatar.errors import MotionError
from echoavatar_lab.foreign.smpl_pickle import read_smpl_pickle
from echoavatar_lab.foreign.smplx_reader import read_smplx


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
    with pytest.raises(MotionError, match=r"a\.pkl: smpl_poses .* SMPL has \(t, 72\)"):
        read_smpl_pickle(write_edge(tmp_path / "a.pkl", poses[:, :66], trans))
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"q": poses}))
    with pytest.raises(MotionError, match=r"a\.pkl has no array 'smpl_poses' \(found: q\)"):
        read_smpl_pickle(tmp_path / "a.pkl")
    (tmp_path / "a.pkl").write_bytes(b"nothing")
    with pytest.raises(MotionError, match=r"a\.pkl is no pickle"):
        read_smpl_pickle(tmp_path / "a.pkl")
    with pytest.raises(MotionError, match="does not exist"):
        read_smpl_pickle(tmp_path / "none.pkl")
