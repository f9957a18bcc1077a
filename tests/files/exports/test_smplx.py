"""SMPL-X in BEAT2's layout, read back by the datasets' reader and taken by the metrics."""

from pathlib import Path

import numpy as np

from echoavatar.files.exports import Take
from echoavatar.files.exports.smplx import write_smplx
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar_lab.data.faults import skate
from echoavatar_lab.foreign.smpl import read_smplx


def test_the_layout_is_beat2s(short: Take, tmp_path: Path) -> None:
    write_smplx(tmp_path / "a.smplx.npz", short)
    with np.load(tmp_path / "a.smplx.npz", allow_pickle=False) as stored:
        shapes = {key: stored[key].shape for key in stored}
        assert float(stored["mocap_frame_rate"]) == 30
        assert str(stored["model"]) == "smplx2020"
        jaw = stored["poses"].reshape(45, 55, 3)[:, 22]
    assert shapes == {
        "betas": (300,),
        "poses": (45, 165),
        "expressions": (45, 100),
        "trans": (45, 3),
        "model": (),
        "gender": (),
        "mocap_frame_rate": (),
    }
    assert np.ptp(jaw[:, 0]) > 0.05
    assert not jaw[:, 1:].any()


def test_the_projects_reader_puts_every_joint_where_it_was(take: Take, tmp_path: Path) -> None:
    write_smplx(tmp_path / "a.smplx.npz", take)
    read = read_smplx(tmp_path / "a.smplx.npz")
    ours, theirs = bone_map(take.motion.skeleton), bone_map(read.skeleton)
    assert len(theirs) == 52
    here, there = take.motion.pose().positions, read.pose().positions
    lifted = there[:, 0, 1] - here[:, 0, 1]  # the reader puts the ankles at rest height: a constant
    assert np.ptp(lifted) < 1e-5
    there[..., 1] -= lifted[:, None]
    for bone, joint in theirs.items():
        np.testing.assert_allclose(there[:, joint], here[:, ours[bone]], atol=2e-5, err_msg=bone)
    feet = [theirs["leftFoot"], theirs["rightFoot"]]
    assert skate(there[:, feet], 30) < 2.0  # cm/s
