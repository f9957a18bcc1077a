from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import ARKIT_NAMES, LIVE_LINK_NAMES
from echoavatar_lab.models.face.clip import FaceClip, load_clips, pair_with_audio, read_live_link


def make(frames: int = 5, **changes: object) -> FaceClip:
    rng = np.random.default_rng(0)
    audio = rng.uniform(-1, 1, frames * 800).astype(np.float32)
    values = {"name": "a", "audio": audio, "curves": rng.random((frames, 52)).astype(np.float32)}
    return FaceClip(**(values | changes))


def test_a_file_gives_back_the_clip(tmp_path):
    clip = make(split="test")
    clip.save(tmp_path / "a.npz")
    (loaded,) = load_clips(tmp_path)
    assert (loaded.name, loaded.split) == ("a", "test")
    np.testing.assert_allclose(loaded.audio, clip.audio, atol=2e-5)
    np.testing.assert_allclose(loaded.curves, clip.curves, atol=6e-4)


def test_columns_go_by_their_names(tmp_path):
    clip = make()
    order = [ARKIT_NAMES.index(name) for name in sorted(ARKIT_NAMES)]
    path = tmp_path / "b.npz"
    np.savez(
        path,
        name=np.array("b"),
        audio=np.zeros(4000, np.int16),
        curves=clip.curves[:, order],
        channels=np.array(sorted(ARKIT_NAMES)),
        split=np.array("train"),
    )
    assert np.array_equal(FaceClip.load(path).curves, clip.curves)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"curves": np.zeros((5, 51), np.float32)}, r"\(5, 51\), wanted \(frames, 52\)"),
        ({"audio": np.zeros(3999, np.float32)}, "wanted 4000"),
        ({"curves": np.full((5, 52), np.nan, np.float32)}, "not numbers"),
        ({"split": "dev"}, "'dev'"),
    ],
)
def test_what_does_not_fit_is_named(changes, words):
    with pytest.raises(MotionError, match=words):
        make(**changes)


def test_missing_and_damaged_files_are_named(tmp_path):
    with pytest.raises(MotionError, match="no face clips"):
        load_clips(tmp_path)
    (tmp_path / "c.npz").write_bytes(b"nothing")
    with pytest.raises(MotionError, match="c.npz is not a readable face clip"):
        load_clips(tmp_path)


REAL = Path(__file__).parents[4] / "../shared/data/face_permissive/livelinkface_mit"
JAW = ARKIT_NAMES.index("jawOpen")


def write(path: Path, *, rate: int = 60, frames: int = 120, names=LIVE_LINK_NAMES, edit=lambda rows: rows) -> Path:
    """A take whose jaw opens steadily from 0 to 1; frames of the timecode count 1/60 s."""
    rows = []
    for i in range(frames):
        count = i * 60 // rate
        stamp = f"10:00:{count // 60:02d}:{count % 60:02d}.000"
        values = [f"{i / max(frames - 1, 1) if name == 'jawOpen' else 0.1:.6f}" for name in names]
        rows.append([stamp, str(len(names)), *values])
    header = ["Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in names)]
    path.write_text("\n".join(",".join(row) for row in edit([header, *rows])) + "\n")
    return path


@pytest.mark.parametrize("rate", [60, 30])
def test_a_take_becomes_30_frames_per_second(tmp_path, rate):
    take = read_live_link(write(tmp_path / "a.csv", rate=rate, frames=2 * rate))
    assert len(take) == 60
    np.testing.assert_allclose(np.diff(take[:59, JAW]), 1 / (2 - 1 / rate) / 30, atol=1e-4)


def test_columns_go_by_name_in_any_order_and_head_may_be_missing(tmp_path):
    take = read_live_link(write(tmp_path / "a.csv", names=tuple(reversed(ARKIT_NAMES))))
    assert take[-2, JAW] > 0.9


def drop(first: int, last: int):
    return lambda rows: rows[:first] + rows[last:]


def test_dropped_frames_are_bridged(tmp_path):
    whole = read_live_link(write(tmp_path / "a.csv"))
    gappy = read_live_link(write(tmp_path / "b.csv", edit=drop(40, 52)))
    np.testing.assert_allclose(gappy, whole, atol=1e-3)


def put(line: int, column: int, value: str):
    def edit(rows: list[list[str]]) -> list[list[str]]:
        rows[line - 1][column] = value
        return rows

    return edit


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"names": [n for n in LIVE_LINK_NAMES if n not in ("jawOpen", "tongueOut")]}, "jawOpen, tongueOut"),
        ({"edit": put(5, 9, "high")}, "line 5: could not convert string to float: 'high'"),
        ({"edit": put(5, 9, "nan")}, "line 5: a value is not finite"),
        ({"edit": put(7, 0, "10:00")}, "line 7: '10:00' is not a timecode"),
        ({"edit": put(9, 0, "10:00:00:00.000")}, "line 9: the timecode does not advance"),
        ({"edit": drop(20, 80)}, "line 21: 1.02 s without a face"),
        ({"rate": 10, "frames": 40}, "10.0 frames per second; wanted 20 to 130"),
        ({"frames": 1}, "1 rows with a face"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, changes, words):
    with pytest.raises(MotionError, match=words):
        read_live_link(write(tmp_path / "a.csv", **changes))


def test_missing_and_empty_files_are_named(tmp_path):
    with pytest.raises(MotionError, match="cannot be read as CSV"):
        read_live_link(tmp_path / "none.csv")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(MotionError, match="is empty"):
        read_live_link(tmp_path / "empty.csv")


def test_sound_and_face_are_cut_to_one_length(tmp_path):
    take = read_live_link(write(tmp_path / "a.csv"))
    audio = np.arange(24_000 * 2 + 12_000, dtype=np.float32) / 1e5
    clip = pair_with_audio("a", take, audio, offset_s=0.25)
    assert (len(clip.curves), clip.audio[0]) == (60, np.float32(0.06))
    early = pair_with_audio("a", take, audio[:48_000], offset_s=-0.1)
    assert (early.audio[:2400] == 0).all()
    with pytest.raises(MotionError, match=r"5.00 s of sound but 2.00 s of face"):
        pair_with_audio("a", take, np.zeros(120_000, np.float32))


@pytest.mark.skipif(
    not REAL.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_a_real_take_is_read():
    take = read_live_link(REAL / "alex_rom_3.csv")
    assert len(take) / 30 == pytest.approx(134.3, abs=0.5)
    assert take[:, JAW].max() > 0.5
