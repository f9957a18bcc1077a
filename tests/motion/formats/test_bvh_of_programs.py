"""BVH as programs write it: read as the plain file is, with a warning that says what was assumed."""

import logging
import re
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle

FRAMES = 4
PERSON = swaying(FRAMES)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("plain") / "a.bvh"
    write_bvh(path, HUMANOID, PERSON.rotations, PERSON.root, 30)
    return path.read_text()


def rows(text: str) -> tuple[str, list[list[str]]]:
    """The text up to the frames, and their values."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    return "\n".join(lines[:first]) + "\n", [line.split() for line in lines[first:]]


def in_rows(text: str, change: Callable[[list[str]], str]) -> str:
    head, table = rows(text)
    return head + "".join(change(row) for row in table)


def with_six_channels(text: str, *, beside: bool = False) -> str:
    """Every joint gets its OFFSET as a position in each frame, or 0 where positions count from there."""
    head, table = rows(text)
    offsets = [line.split()[1:] for line in head.splitlines() if line.strip().startswith("OFFSET")]
    kinds = re.findall(r"ROOT|JOINT|End Site", head)
    places = [offset for kind, offset in zip(kinds, offsets, strict=True) if kind == "JOINT"]
    head = head.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ")
    wide = []
    for row in table:
        parts = [row[:6]]
        for k, place in enumerate(places):
            parts.append((["0"] * 3 if beside else place) + row[6 + 3 * k : 9 + 3 * k])
        wide.append(" ".join(word for part in parts for word in part))
    return head + "\n".join(wide) + "\n"


def beside(text: str, *names: str) -> str:
    """The body hangs from a root, beside other joints; all of them may move."""
    channels = "OFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation\n"
    others = "".join(f"JOINT {name}\n{{\n{channels}End Site\n{{\nOFFSET 0 0 0\n}}\n}}\n" for name in names)
    text = text.replace("ROOT hips", f"ROOT root\n{{\n{channels}JOINT hips").replace("MOTION", f"{others}}}\nMOTION")
    return in_rows(text, lambda row: " ".join(["0"] * 6 + row + ["0"] * 6 * len(names)) + "\n")


SAME: dict[str, tuple[Callable[[str], str | bytes], str]] = {  # what a program does, and what the warning says
    "one row more than the header says": (
        lambda t: t.replace("Frames: 4", "Frames: 3"),
        "it says 3 frames, and the 4 that it has",
    ),
    "one row less": (lambda t: t.replace("Frames: 4", "Frames: 5"), "it says 5 frames, and the 4"),
    "no count": (lambda t: t.replace("Frames: 4\n", ""), "it says 0 frames"),
    "braces on the line": (lambda t: re.sub(r"\n\s*\{", " {", t), ""),
    "braces that touch": (lambda t: re.sub(r"\n\s*\{", "{", t), ""),
    "one line for a joint": (lambda t: re.sub(r"\n\s*(\{|OFFSET|CHANNELS|\})", r" \1", t), ""),
    "CR LF": (lambda t: t.replace("\n", "\r\n"), ""),
    "CR": (lambda t: t.replace("\n", "\r"), ""),
    "tabs": (lambda t: t.replace(" ", "\t").replace("End\tSite", "End Site"), ""),
    "spaces at the ends of lines": (lambda t: t.replace("\n", "  \n"), ""),
    "blank lines": (lambda t: in_rows(t, lambda row: "\n\n" + " ".join(row) + "\n \t\n"), ""),
    "NUL behind": (lambda t: t + "\0\0\n\0", ""),
    "Ctrl-Z behind": (lambda t: t + "\x1a", ""),
    "no line end": (lambda t: t.rstrip(), ""),
    "a byte order mark": (lambda t: b"\xef\xbb\xbf" + t.encode(), ""),
    "UTF-16": (lambda t: t.encode("utf-16"), "utf-16"),
    "UTF-16 of the other end": (lambda t: b"\xfe\xff" + t.encode("utf-16-be"), "utf-16"),
    "UTF-16 without a mark": (lambda t: t.encode("utf-16-le"), "utf-16"),
    "UTF-16 of the other end without a mark": (lambda t: t.encode("utf-16-be"), "utf-16"),
    "small letters": (lambda t: t.lower(), ""),
    "capitals": (lambda t: re.sub("rotation|position|Frames|Frame Time|End Site", lambda m: m[0].upper(), t), ""),
    "Motion": (lambda t: t.replace("MOTION", "Motion").replace("HIERARCHY", "Hierarchy"), ""),
    "spaces around the colon": (lambda t: t.replace("Frames: ", "Frames :").replace("Time: ", "Time \t: "), ""),
    "equal signs": (lambda t: t.replace("Frames:", "Frames =").replace("Time:", "Time ="), ""),
    "no space behind the colon": (lambda t: t.replace("Frames: ", "Frames:").replace("Time: ", "Time:"), ""),
    "decimal commas": (lambda t: t.replace(".", ","), ""),
    "commas behind numbers": (lambda t: in_rows(t, lambda row: ", ".join(row) + ",\n"), ""),
    "commas alone": (lambda t: in_rows(t, lambda row: ",".join(row) + "\n"), ""),
    "exponents": (lambda t: in_rows(t, lambda row: " ".join(f"{float(x):.9e}" for x in row) + "\n"), ""),
    "plus signs": (lambda t: in_rows(t, lambda row: " ".join(f"{float(x):+f}" for x in row) + "\n"), ""),
    "comments": (
        lambda t: "# made by hand\n" + in_rows(t, lambda row: "// a frame\n" + " ".join(row) + "  # so far\n"),
        "",
    ),
    "a frame on several lines": (
        lambda t: in_rows(t, lambda row: "\n".join(" ".join(row[k : k + 50]) for k in range(0, len(row), 50)) + "\n"),
        "",
    ),
    "lines of eight numbers": (
        lambda t: rows(t)[0] + re.sub(r"((?:\S+ ){7}\S+) ", r"\1\n", " ".join(sum(rows(t)[1], []))),
        "",
    ),
    "a number a line": (lambda t: in_rows(t, lambda row: "\n".join(row) + "\n"), ""),
    "all on one line": (lambda t: in_rows(t, lambda row: " ".join(row) + " "), ""),
    "more values than channels": (lambda t: in_rows(t, lambda row: " ".join([*row, "7"]) + "\n"), "the first 159"),
    "no frame time": (lambda t: re.sub("Frame Time.*\n", "", t), "30 frames per second are assumed"),
    "a frame time of 0": (lambda t: re.sub("Time: .*", "Time: 0.000", t), "30 frames per second are assumed"),
    "a frame time with a comma": (lambda t: re.sub("Time: .*", "Time: 0,0333333", t), ""),
    "cut within the last frame": (lambda t: t.rstrip() + "\n12.5 95", "it ends within frame 5"),
    "cut within a number": (lambda t: t.rstrip() + "\n12.5 95 -", "it ends within frame 5"),
    "cut within an exponent": (lambda t: t.rstrip() + "\n12.5 95 1.5e-", "it ends within frame 5"),
    "decimal commas and commas": (lambda t: in_rows(t.replace(".", ","), lambda row: ", ".join(row) + ",\n"), ""),
    "six channels on every joint": (with_six_channels, ""),
    "positions beside the OFFSET": (lambda t: with_six_channels(t, beside=True), "added to their OFFSET"),
    "scale": (
        lambda t: in_rows(
            t.replace("CHANNELS 6 Xposition", "CHANNELS 9 Xscale Yscale Zscale Xposition"),
            lambda row: " ".join(["1", "1", "1", *row]) + "\n",
        ),
        "scale channels are left out",
    ),
    "a joint without channels": (
        lambda t: t.replace("\tEnd Site", "\tJOINT prop\n{\nOFFSET 0 1 0\nCHANNELS 0\n}\n\tEnd Site", 1),
        "",
    ),
    "a joint without a name": (
        lambda t: t.replace("\tEnd Site", "\tJOINT\n{\nOFFSET 0 1 0\nCHANNELS 0\n}\n\tEnd Site", 1),
        "",
    ),
    "an end without OFFSET": (lambda t: re.sub(r"(End Site\n\s*\{)\n\s*OFFSET.*", r"\1", t, count=1), ""),
    "a name that occurs twice": (
        lambda t: t.replace("\tEnd Site", "\tJOINT hips\n{\nOFFSET 0 1 0\nCHANNELS 0\n}\n\tEnd Site", 1),
        "joints of the same name are numbered",
    ),
    "a root": (beside, ""),
    "a root and targets of IK": (lambda t: beside(t, "ik_foot_root", "ik_hand_root"), "joints beside 'hips' are left"),
    "a sword beside the body": (
        lambda t: in_rows(
            t.replace("ROOT", "ROOT hips\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n}\nROOT", 1),
            lambda row: " ".join(["5", *row]) + "\n",
        ),
        "2 skeletons, and that of 'hips'",
    ),
    "a sword behind the body": (
        lambda t: in_rows(
            t.replace("MOTION", "ROOT sword\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n}\nMOTION", 1),
            lambda row: " ".join([*row, "5"]) + "\n",
        ),
        "2 skeletons, and that of 'hips'",
    ),
}


@pytest.mark.parametrize("name", SAME)
def test_what_programs_write_is_read_as_the_plain_file(name, plain, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    change, said = SAME[name]
    changed = change(plain)
    path = tmp_path / "a.bvh"
    path.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    with caplog.at_level(logging.WARNING):
        motion = read_bvh(path)
    assert said in caplog.text
    assert (not said) == (not caplog.text)
    assert (motion.frames, motion.fps) == (FRAMES, 30)
    theirs = [name.lower() for name in motion.skeleton.names]
    at = [theirs.index(name.lower()) for name in HUMANOID.names]
    np.testing.assert_allclose(motion.pose().positions[:, at], PERSON.pose().positions, atol=2e-5, rtol=0)


@pytest.mark.parametrize(
    ("name", "encoding", "said"),
    [
        ("左ひじ", "shift_jis", "shift_jis"),
        ("センター", "cp932", "shift_jis"),
        ("左手腕", "gbk", "gb2312"),
        ("傳左腕", "gbk", "gbk"),
        ("Bündel", "latin-1", "cp1252"),
        ("épaule", "cp1252", "cp1252"),
        ("左ひじ", "utf-16", "utf-16"),
        ("Größe 左", "utf-8", ""),
    ],
)
def test_names_in_other_encodings(name, encoding, said, plain, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.bvh"
    path.write_bytes(plain.replace("JOINT leftThumbDistal", f"JOINT {name}").encode(encoding))
    motion = read_bvh(path)
    assert "_".join(name.split()) in motion.skeleton.names
    assert said in caplog.text
    assert (not said) == (not caplog.text)


RATES = [
    ("0.0333667", Fraction(30000, 1001)),
    ("0,0333667,", Fraction(30000, 1001)),
    (".03336670", Fraction(30000, 1001)),
    ("0.033366666666667", Fraction(30000, 1001)),
    ("0.03337", Fraction(30000, 1001)),
    ("0.0334", Fraction(30000, 1001)),
    ("0.016683", Fraction(60000, 1001)),
    ("0.01668335", Fraction(60000, 1001)),
    ("0.0417083", Fraction(24000, 1001)),
    ("0.04170833333", Fraction(24000, 1001)),
    ("0.00834167", Fraction(120000, 1001)),
    (".0333333", 30),
    ("0.03333", 30),
    ("0.0333", 30),
    ("0.033", 30),
    ("3.33333e-02", 30),
    ("0.033333335", 30),
    ("0.016667", 60),
    ("0.01666", 60),
    ("0.0167", 60),
    ("0.017", 60),
    ("0.0083333", 120),
    ("0.0083", 120),
    ("0.008", 125),
    ("0.041667", 24),
    ("0.04", 25),
    ("0.0111", 90),
    ("0.005", 200),
    ("0.08", Fraction(25, 2)),
    ("0.015", 1 / 0.015),
]


@pytest.mark.parametrize(("seconds", "rate"), RATES)
def test_a_rounded_frame_time_means_the_rate_that_it_came_from(seconds, rate, plain, tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "a.bvh").write_text(re.sub("Time: .*", f"Time: {seconds}", plain))
    assert read_bvh(tmp_path / "a.bvh").fps == float(rate)


@pytest.mark.parametrize("rate", [24000 / 1001, 30000 / 1001, 60000 / 1001, 29.97, 59.94, 23.976, 119.88])
def test_ten_minutes_stay_ten_minutes(rate, tmp_path) -> None:  # type: ignore[no-untyped-def]
    frames = round(600 * rate)
    head = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n}\nMOTION\n"
    values = "\n".join(f"{100 * k / rate:.4f}" for k in range(frames))  # a metre a second
    (tmp_path / "a.bvh").write_text(f"{head}Frames: {frames}\nFrame Time: {1 / rate:.7f}\n{values}\n")
    motion = read_bvh(tmp_path / "a.bvh")
    assert motion.seconds == pytest.approx(600, abs=0.03)
    ours = resample(motion, 30.0)
    assert ours.seconds == pytest.approx(600, abs=0.05)
    np.testing.assert_allclose(ours.root[:, 0], np.arange(ours.frames) / 30, atol=1e-3)
    write_bvh(tmp_path / "b.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    assert read_bvh(tmp_path / "b.bvh").fps == motion.fps


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda t: in_rows(t, lambda row: " ".join(["nan", *row[1:]]) + "\n"), "line 317: 'nan'"),
        (lambda t: in_rows(t, lambda row: " ".join([*row[:-1], "1.#IND"]) + "\n"), "line 317: '1.#IND'"),
        (lambda t: in_rows(t, lambda row: " ".join(["-nan(ind)", *row[1:]]) + "\n"), "line 317: '-nan"),
        (lambda t: in_rows(t, lambda row: " ".join(["1e999", *row[1:]]) + "\n"), "line 317: '1e999'"),
        (lambda t: t.replace("OFFSET 0.000000 7.5", "OFFSET 0,0,0 7.5"), "OFFSET needs three"),
        (lambda t: re.sub("Time: .*", "Time: inf", t), "expected 'Frame Time:' and a number"),
        (lambda t: re.sub("Time: .*", "Time: 1/30", t), "expected 'Frame Time:' and a number"),
        (lambda t: re.sub("Time: .*", "Time: 30", t), "line 316: Frame Time 30 is not 0.0001 to 2"),
        (lambda t: re.sub("Time: .*", "Time: 8.333", t), "Frame Time 8.333 is not 0.0001 to 2"),
        (lambda t: t.replace("ROOT hips\n{", "ROOT hips"), "is not BVH"),
        (lambda t: "\n".join(t.splitlines()[:200]), "the file ends before MOTION"),
        (lambda t: rows(t)[0], "has no frames"),
        (lambda t: t.replace("ROOT hips", "End Site", 1), "line 2: 'End Site' is not BVH"),
        (lambda t: t.replace("End Site", "JOINT hand", 1).replace("\tJOINT", "\tEnd JOINT", 1), "is not BVH"),
        (lambda t: t.replace("JOINT spine\n", "JOINT spine" + " " * 250_000 + "\n").replace("{", ""), "is not BVH"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line_at_once(change, complaint, plain, tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.bvh"
    path.write_text(change(plain))
    start = time.process_time()
    with pytest.raises(MotionError, match=rf"a\.bvh.*{re.escape(complaint)}"):
        read_bvh(path)
    assert time.process_time() - start < 2


@pytest.mark.parametrize("name", [b"\x81", b"\xb6\xd2\x81\x20", b"\xe9paule\x8d"])
def test_names_in_no_encoding_at_all_are_replaced(name: bytes, plain: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(plain.encode().replace(b"JOINT leftThumbDistal", b"JOINT thumb " + name))
    assert read_bvh(path).skeleton.joints == HUMANOID.joints


@pytest.mark.parametrize("size", ["1e39", "1e300", "-3e38"])
def test_sizes_beyond_any_body_are_no_trouble(size, plain, tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "a.bvh").write_text(re.sub(r"OFFSET 0.000000 7\S+", f"OFFSET 0 {size}", plain, count=1))
    try:
        read_bvh(tmp_path / "a.bvh")
    except MotionError:
        return


def test_a_frame_that_lacks_a_value_is_refused(plain, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    head, table = rows(plain)
    (tmp_path / "a.bvh").write_text(head + "\n".join(" ".join(row[k == 1 :]) for k, row in enumerate(table)))
    with pytest.raises(MotionError, match="158 values, but the hierarchy has 159 channels"):
        read_bvh(tmp_path / "a.bvh")


@pytest.fixture(scope="module")
def in_radians(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Somebody whose arms hang, in radians."""
    path, turns = tmp_path_factory.mktemp("radians") / "a.bvh", PERSON.rotations.copy()
    for side, sign in (("left", -1), ("right", 1)):
        turns[:, HUMANOID.index(f"{side}UpperArm")] = [np.cos(0.7), 0, 0, sign * np.sin(0.7)]
    write_bvh(path, HUMANOID, turns, PERSON.root, 30)
    degrees = path.read_text()
    return in_rows(degrees, lambda row: " ".join([*row[:3], *(f"{np.radians(float(x)):.9f}" for x in row[3:])]) + "\n")


def test_angles_in_radians_are_taken_for_these(
    in_radians: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "a.bvh").write_text(in_radians)
    motion = read_bvh(tmp_path / "a.bvh")
    index = HUMANOID.index
    turns = {joint: motion.rotations[:, joint] for joint in range(HUMANOID.joints)}
    for side, sign in (("left", -1), ("right", 1)):
        np.testing.assert_allclose(
            np.abs(turns.pop(index(f"{side}UpperArm")) @ [np.cos(0.7), 0, 0, sign * np.sin(0.7)]), 1, atol=1e-6
        )
    for joint, found in turns.items():
        np.testing.assert_allclose(np.abs((found * PERSON.rotations[:, joint]).sum(1)), 1, atol=1e-6)
    assert "its angles are taken for radians" in caplog.text


@pytest.mark.parametrize("what", ["nobody moves", "the arms hang at rest", "somebody would fall", "a T-pose sways"])
def test_angles_that_may_be_radians_are_told(
    what: str, in_radians: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = in_radians
    if what == "somebody would fall":
        text = in_rows(text, lambda row: " ".join([*row[:5], "2.9", *row[6:]]) + "\n")
    elif what == "a T-pose sways":
        axes = np.zeros((60, HUMANOID.joints, 3))
        axes[..., 2] = np.radians(0.4) * np.sin(np.linspace(0, 6, 60))[:, None]
        axes[:, [HUMANOID.index("leftUpperArm"), HUMANOID.index("rightUpperArm")]] *= 6
        root = np.tile(HUMANOID.rest_positions[0], (60, 1)).astype(np.float32)
        write_bvh(tmp_path / "b.bvh", HUMANOID, quaternion_from_axis_angle(axes).astype(np.float32), root, 30)
        text = (tmp_path / "b.bvh").read_text()
    elif what == "nobody moves":
        head, table = rows(text)
        text = head + (" ".join(table[1]) + "\n") * FRAMES
    else:
        arm = r"(JOINT (?:left|right)LowerArm\n\s*\{\n\s*OFFSET) (\S+) \S+ \S+"
        text = re.sub(arm, lambda found: f"{found[1]} 0 -26.5 0", text)
    (tmp_path / "a.bvh").write_text(text)
    read_bvh(tmp_path / "a.bvh")
    assert "if they are radians, write degrees" in caplog.text
