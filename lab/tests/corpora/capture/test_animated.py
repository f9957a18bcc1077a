"""Motion keyed by animators, from files made here: where the arms are in known poses, and how keys are joined."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.capture.animated import read_animated

STRAIGHT = bytes([20] * 32 + [107] * 32)
Key = tuple[str, int, tuple[float, float, float, float], bytes]


def vmd(path: Path, keys: list[Key]) -> Path:
    """Keys: bone, frame, rotation xyzw, curves."""
    data = b"Vocaloid Motion Data 0002".ljust(30, b"\0") + b"Mei".ljust(20, b"\0") + struct.pack("<I", len(keys))
    for bone, frame, rotation, curves in keys:
        data += bone.encode("shift_jis").ljust(15, b"\0") + struct.pack("<I7f", frame, 0, 0, 0, *rotation) + curves
    path.write_bytes(data)
    return path


def about(axis: int, degrees: float) -> tuple[float, float, float, float]:
    half = np.deg2rad(degrees) / 2
    turn = [0.0, 0.0, 0.0, float(np.cos(half))]
    turn[axis] = float(np.sin(half))
    return (turn[0], turn[1], turn[2], turn[3])


def way(motion: Motion, start: str, end: str, frame: int = 0) -> np.ndarray:
    places = motion.pose().positions[frame]
    line = places[HUMANOID.index(end)] - places[HUMANOID.index(start)]
    return line / np.linalg.norm(line)


def qianim(path: Path, **curves: list[tuple[float, float]]) -> Path:
    """Curves of keys (frame, degrees) with flat tangents a third of the way long."""
    text = ""
    for joint, keys in curves.items():
        text += f'<ActuatorCurve actuator="{joint}" fps="25" unit="degree">'
        far = (keys[-1][0] - keys[0][0]) / 3
        for frame, value in keys:
            sides = "".join(f'<Tangent side="{s}" abscissaParam="{w}"/>' for s, w in (("left", -far), ("right", far)))
            text += f'<Key frame="{frame}" value="{value}">{sides}</Key>'
        text += "</ActuatorCurve>"
    path.write_text(f'<?xml version="1.0"?><Animation typeVersion="2.0">{text}</Animation>')
    return path


def test_arms_of_an_unturned_vmd_body_hang_by_37_degrees(tmp_path: Path):
    motion = read_animated(vmd(tmp_path / "a.vmd", [("頭", 0, (0, 0, 0, 1), STRAIGHT)]))
    down, aside = np.sin(np.deg2rad(37)), np.cos(np.deg2rad(37))
    np.testing.assert_allclose(way(motion, "leftUpperArm", "leftHand"), [aside, -down, 0], atol=1e-5)
    np.testing.assert_allclose(way(motion, "rightUpperArm", "rightHand"), [-aside, -down, 0], atol=1e-5)


def test_vmd_is_left_handed_and_its_body_faces_backwards(tmp_path: Path):
    """A quarter turn about VMD's y axis takes its left, +X, to its back, -Z of a body that faces -Z: our -Z is back."""
    motion = read_animated(vmd(tmp_path / "a.vmd", [("左ひじ", 0, about(1, 90), STRAIGHT)]))
    forearm = way(motion, "leftLowerArm", "leftHand")
    assert forearm[2] == pytest.approx(np.cos(np.deg2rad(37)), abs=1e-5)
    np.testing.assert_allclose(way(motion, "leftUpperArm", "leftLowerArm")[2], 0, atol=1e-5)


def test_vmd_keys_are_joined_along_the_curve_of_the_later_one(tmp_path: Path):
    slow = bytes(STRAIGHT[:48]) + bytes([120, 0, 0, 0, 0, 0, 0, 0, 127, 0, 0, 0, 10, 0, 0, 0])
    keys = [("首", 0, about(1, 0), STRAIGHT), ("首", 20, about(1, 60), STRAIGHT), ("首", 40, about(1, 0), slow)]
    motion = read_animated(vmd(tmp_path / "a.vmd", keys))
    turned = 2 * np.degrees(np.arccos(np.clip(motion.rotations[:, HUMANOID.index("neck"), 0], -1, 1)))
    assert len(motion.rotations) == 41
    assert turned[[0, 10, 20, 40]] == pytest.approx([0, 30, 60, 0], abs=0.1)
    assert turned[30] > 45


def test_a_damaged_file_is_named(tmp_path: Path):
    whole = vmd(tmp_path / "a.vmd", [("頭", 0, (0, 0, 0, 1), STRAIGHT)]).read_bytes()
    (tmp_path / "cut.vmd").write_bytes(whole[:-30])
    (tmp_path / "no.vmd").write_bytes(b"something else")
    (tmp_path / "no.qianim").write_text("<Animation>")
    for name in ("cut.vmd", "no.vmd", "no.qianim", "missing.vmd"):
        with pytest.raises(MotionError, match=name):
            read_animated(tmp_path / name)
    with pytest.raises(MotionError, match="no bone"):
        read_animated(vmd(tmp_path / "b.vmd", [("センター", 0, (0, 0, 0, 1), STRAIGHT)]))


@pytest.mark.parametrize(
    "keys",
    [
        [("頭", 600_000, (0, 0, 0, 1), STRAIGHT)],  # 200 bytes for five hours of 52 joints
        [("頭", 0xFFFFFFFF, (0, 0, 0, 1), STRAIGHT)],
        [("頭", 0, (np.nan, 0, 0, 1), STRAIGHT)],
        [("頭", 0, (np.inf, 0, 0, 1), STRAIGHT), ("頭", 9, (0, 0, 0, 1), STRAIGHT)],
    ],
)
def test_a_hostile_vmd_is_refused_in_little_memory(keys: list[Key], tmp_path: Path):
    tracemalloc.start()
    try:
        with pytest.raises(MotionError):
            read_animated(vmd(tmp_path / "a.vmd", keys))
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "curve",
    ['fps="0"><Key frame="1" value="0"/>', 'fps="25"><Key frame="1e999" value="0"/>',
     'fps="nan"><Key frame="1" value="0"/>', 'fps="25"><Key frame="0" value="1e999"/>'],
)  # fmt: skip
def test_a_hostile_qianim_is_refused(curve: str, tmp_path: Path):
    (tmp_path / "a.qianim").write_text(
        f'<Animation><ActuatorCurve actuator="HeadYaw" {curve}</ActuatorCurve></Animation>'
    )
    with pytest.raises(MotionError):
        read_animated(tmp_path / "a.qianim")


def test_a_header_that_states_more_keys_than_there_are_is_refused_at_once(tmp_path: Path):
    path = vmd(tmp_path / "a.vmd", [("頭", 0, (0, 0, 0, 1), STRAIGHT)])
    data = bytearray(path.read_bytes())
    data[50:54] = b"\xff" * 4
    path.write_bytes(data)
    with pytest.raises(MotionError, match="cannot be read as .vmd"):
        read_animated(path)


def test_peppers_arms_point_ahead_at_zero_and_hang_at_ninety_degrees(tmp_path: Path):
    motion = read_animated(qianim(tmp_path / "a.qianim", LShoulderPitch=[(0, 90)], RElbowRoll=[(0, 90)]))
    np.testing.assert_allclose(way(motion, "leftUpperArm", "leftHand"), [0, -1, 0], atol=1e-5)
    np.testing.assert_allclose(way(motion, "rightUpperArm", "rightLowerArm"), [0, 0, 1], atol=1e-5)
    np.testing.assert_allclose(way(motion, "rightLowerArm", "rightHand"), [1, 0, 0], atol=1e-5)


def test_a_qianim_curve_is_smooth_between_its_keys(tmp_path: Path):
    motion = read_animated(qianim(tmp_path / "a.qianim", HeadYaw=[(0, 0), (25, 40)]))
    turned = 2 * np.degrees(np.arccos(np.clip(motion.rotations[:, HUMANOID.index("head"), 0], -1, 1)))
    assert len(turned) == 31
    assert turned[[0, 15, 30]] == pytest.approx([0, 20, 40], abs=0.2)
    assert turned[1] < 1
    assert np.all(np.diff(turned) > 0)
