"""BVH: what is written is read back, foreign files are understood, broken ones are explained."""

import os
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.motion.kinematics.samples import matrix_from_euler, recorded

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh

SMALL = """HIERARCHY
ROOT base
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT arm left
  {
    OFFSET 10 0 0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site
    {
      OFFSET 5 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.033333
1 91 2 10 20 30 40 50 60
1 92 2 10 20 30 40 50 60
"""


def test_channels_are_taken_in_their_own_order(tmp_path):
    path = tmp_path / "small.bvh"
    path.write_text(SMALL)
    motion = read_bvh(path)
    turns = np.radians([[10.0, 20, 30], [40, 50, 60]])
    np.testing.assert_allclose(
        motion.matrices()[0, 0].astype(np.float64), matrix_from_euler(turns[0], "zyx"), atol=1e-6, rtol=0
    )
    np.testing.assert_allclose(
        motion.matrices()[0, 1].astype(np.float64), matrix_from_euler(turns[1], "yxz"), atol=1e-6, rtol=0
    )
    np.testing.assert_allclose(motion.root, [[0.01, 0.91, 0.02], [0.01, 0.92, 0.02]], atol=1e-7)
    assert motion.fps == 30
    assert motion.skeleton.names == ("base", "arm_left")
    assert motion.skeleton.config.tips == {"arm_left": (0.05, 0.0, 0.0)}


def test_a_travelling_child_takes_the_root_over(tmp_path):
    """As in the Bandai-Namco files: the root stands still and the hips have position channels."""
    text = SMALL.replace("CHANNELS 3 Yrotation", "CHANNELS 6 Xposition Yposition Zposition Yrotation")
    text = text.replace("1 91 2 10 20 30 40", "1 91 2 90 0 0 10 0 0 40").replace(
        "1 92 2 10 20 30 40", "1 91 2 90 0 0 12 0 0 40"
    )
    (tmp_path / "a.bvh").write_text(text)
    motion = read_bvh(tmp_path / "a.bvh")
    assert motion.skeleton.names == ("arm_left",)
    np.testing.assert_allclose(motion.root, [[0.01, 1.01, 0.02], [0.01, 1.03, 0.02]], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda text: "", "line 1: the file does not begin with HIERARCHY"),
        (lambda text: "RIFF", "line 1: the file does not begin"),
        (lambda text: text[:120], "cut short"),
        (lambda text: text.replace("}\nMOTION", "MOTION"), "closing brace"),
        (lambda text: text.replace("OFFSET 10 0 0", "OFFSET 10 0"), "line 8: OFFSET needs three"),
        (lambda text: text.replace("OFFSET 10 0 0", "OFFSET inf 0 0"), "line 8: OFFSET needs three finite"),
        (lambda text: text.replace("CHANNELS 3 ", "CHANNELS 4 "), "line 9: 'CHANNELS 4 Yrotation.* is not BVH"),
        (lambda text: text.replace("Zrotation\n    End", "Wrotation\n    End"), "line 9: .*Wrotation' is not BVH"),
        (lambda text: text.replace("JOINT arm left", "BONE arm"), "line 6: 'BONE arm' is not BVH"),
        (lambda text: text.replace("Frames: 2", "Frames: many"), "expected 'Frames:'"),
        (lambda text: text.replace("0.033333", "-1"), "Frame Time -1 is not 0.0001 to 2"),
        (lambda text: text.replace("1 91 2", "1 91"), "line 19: 8 values, but the hierarchy has 9"),
        (lambda text: text.replace("1 92 2", "1.#IND 92 2"), "line 20: '1.#IND' is not a finite number"),
        (lambda text: text.replace("1 92 2", "1 nan 2"), "line 20: 'nan' is not a finite number"),
        (lambda text: text.replace("1 92 2", "1 9x 2"), "line 20: '9x' is not a finite number"),
        (lambda text: text.split("1 91")[0], "no frames"),
    ],
)
def test_broken_files_are_explained(tmp_path, change, complaint):
    path = tmp_path / "broken.bvh"
    path.write_text(change(SMALL))
    with pytest.raises(MotionError, match=complaint):
        read_bvh(path)


def test_without_frames_the_rest_pose_is_read(tmp_path, caplog):
    path = tmp_path / "a.bvh"
    path.write_text(SMALL)
    rest = read_bvh(path).skeleton.rest_positions
    path.write_text(SMALL.split("1 91")[0].replace("Frames: 2", "Frames: 0"))
    motion = read_bvh(path)
    assert motion.frames == 1
    assert "it has no frames, and its rest pose is read" in caplog.text
    np.testing.assert_array_equal(motion.skeleton.rest_positions, rest)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_cutting_anywhere_is_an_error_of_ours_or_no_error(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "cut.bvh"
    path.write_text(SMALL[: data.draw(st.integers(0, len(SMALL)))])
    try:
        frames = read_bvh(path).frames
    except MotionError:
        return
    assert frames in (1, 2)


def test_missing_and_binary_files_are_explained(tmp_path):
    with pytest.raises(MotionError, match="does not exist"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "noise.bvh").write_bytes(bytes(range(256)))
    with pytest.raises(MotionError, match="not a BVH"):
        read_bvh(tmp_path / "noise.bvh")


def test_a_long_file_is_read_in_no_time():
    path = recorded("motion_eval_only/zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh")
    start = time.process_time()
    motion = read_bvh(path)
    assert motion.frames == 2065
    assert time.process_time() - start < 2


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda text: text.replace("Frames: 2", "Frames: nan"), "expected 'Frames:' and a number, not 'nan'"),
        (lambda text: text.replace("Frames: 2", "Frames: inf"), "expected 'Frames:' and a number, not 'inf'"),
        (lambda text: many_joints(100_000), "more than 1024 joints"),
        (lambda text: many_joints(1000, depth=1000), "512 deep"),
        (lambda text: many_joints(1000, frames=20_000), "20,000 frames of 1,000 joints are more than"),
    ],
    ids=["nan", "inf", "joints", "depth", "rotations"],
)
def test_hostile_files_are_refused_at_once_in_little_memory(tmp_path, change, complaint):
    """Some hundred kilobytes asked for 8.9 GiB, or took minutes."""
    path = tmp_path / "hostile.bvh"
    path.write_text(change(SMALL))
    tracemalloc.start()
    start = time.process_time()
    try:
        with pytest.raises(MotionError, match=rf"hostile\.bvh.*{complaint}"):
            read_bvh(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 28
    finally:
        tracemalloc.stop()
    assert time.process_time() - start < 20


def many_joints(count: int, *, depth: int = 1, frames: int = 1) -> str:
    """A root that moves along X alone, with joints that have no channels: side by side, or in a chain."""
    joint = "JOINT j{0}\n{{\nOFFSET 0 0 0\nCHANNELS 0\n"
    below = [joint.format(k) for k in range(1, count)]
    tree = "".join(below) + "}\n" * (count - 1) if depth > 1 else "".join(part + "}\n" for part in below)
    head = f"HIERARCHY\nROOT j0\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n{tree}}}\n"
    return f"{head}MOTION\nFrames: {frames}\nFrame Time: 0.1\n" + "0\n" * frames


def test_a_pipe_is_refused_before_it_is_opened(tmp_path):
    os.mkfifo(tmp_path / "a.bvh")
    with pytest.raises(MotionError, match="not a regular file"):
        read_bvh(tmp_path / "a.bvh")
