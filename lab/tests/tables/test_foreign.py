from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import write_beat2
from lab.tests.evaluation.clips import clip
from lab.tests.foreign.test_smpl_pickle import write_edge
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.files.exports.smplx import skeleton
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.foreign.smplx_reader import read_smplx
from echoavatar_lab.tables.foreign import foreign_motion


def smplx(folder: Path, name: str, seconds: float = 3.0) -> Path:
    """Motion as EMAGE writes it: `res_NAME.npz` beside the true `gt_NAME.npz`."""
    path = write_beat2(folder / "source", name, seconds)
    made = folder / "made"
    made.mkdir(exist_ok=True)
    for kind in ("res", "gt"):
        (made / f"{kind}_{name}.npz").write_bytes(path.read_bytes())
    return made


def test_motion_as_emage_writes_it_stays_on_its_rig_or_comes_to_ours(tmp_path: Path) -> None:
    made = smplx(tmp_path, "2_scott_0_1_1")
    wanted = clip("2_scott_0_1_1", 90)
    own = foreign_motion(made, wanted, skeleton())
    np.testing.assert_allclose(own.rotations, read_smplx(made / "res_2_scott_0_1_1.npz").rotations, atol=1e-6)
    assert foreign_motion(made, wanted, HUMANOID).skeleton.names == HUMANOID.names


def test_motion_as_edge_writes_it_and_bvh_come_to_our_rig(tmp_path: Path) -> None:
    with np.load(write_beat2(tmp_path, "a", is_z_up=True)) as stored:
        write_edge(tmp_path / "test_a.pkl", stored["poses"][:, :72], stored["trans"])
    motion = swaying(90)
    write_bvh(tmp_path / "b.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    for name in ("a", "b"):
        assert foreign_motion(tmp_path, clip(name, 90), HUMANOID).frames == 90


def test_what_does_not_fit_is_named(tmp_path: Path) -> None:
    made = smplx(tmp_path, "a")
    with pytest.raises(MotionError, match=r"made lacks the test clip b \(it holds 1 files, for example a\)"):
        foreign_motion(made, clip("b", 90), HUMANOID)
    with pytest.raises(MotionError, match=r"res_a\.npz has 90 frames, the test clip 200; make motion for the whole"):
        foreign_motion(made, clip("a", 200), HUMANOID)
    assert foreign_motion(made, clip("a", 150), HUMANOID).frames == 90  # EMAGE drops the end
    motion = swaying(90)
    write_bvh(tmp_path / "a.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    with pytest.raises(MotionError, match=r"a\.bvh: it has 52 joints .* this table is on 55"):
        foreign_motion(tmp_path, clip("a", 90), skeleton())
    with np.load(made / "res_a.npz") as stored:
        arrays = dict(stored)
    arrays["trans"][4] = np.nan
    np.savez(made / "res_a.npz", **arrays)
    with pytest.raises(MotionError, match=r"res_a\.npz, frame 4: .*not finite; repair or leave out"):
        foreign_motion(made, clip("a", 90), HUMANOID)
    arrays["trans"][4] = 0
    np.savez(made / "res_a.npz", **arrays | {"mocap_frame_rate": 60})
    with pytest.raises(MotionError, match=r"res_a\.npz is at 60 frames per second, .* --resample"):
        foreign_motion(made, clip("a", 45), HUMANOID)
    assert foreign_motion(made, clip("a", 45), HUMANOID, is_resampling=True).frames == 45
