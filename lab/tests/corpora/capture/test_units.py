"""Single gestures cut out of longer files by a table."""

from pathlib import Path

import numpy as np
import pytest
from lab.tests.corpora.capture.people import swaying

from echoavatar.errors import MotionError
from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary, gesture_units, read_folder
from echoavatar_lab.corpora.capture.units import ACCENT, Row, cut_out, unit_rows
from echoavatar_lab.corpora.controls import Controls, minimum_jerk, neutral

HEAD = "file,start_s,end_s,height,concept,tempo\n"


def reaching(frames: int, *, side: int = 1) -> Controls:
    """One hand waits for a second, and is raised by 0.3 m within the next one."""
    controls = neutral(frames)
    controls.wrist[:, side, 1] += 0.3 * minimum_jerk(np.arange(frames) / 30 - 1)
    return controls


def test_rows_that_speech_can_use_are_kept_by_file(tmp_path: Path):
    (tmp_path / "gesture_units.csv").write_text(
        HEAD
        + "x/set/a.bvh,1,2,-0.2,,1\nx/set/a.bvh,3,4.5,0.9,point,0.8\nset/a.bvh,5,6,0.9,,1\nset/b.vmd,0,1,0,yawn,1\n"
    )
    (tmp_path / "below").mkdir()
    assert unit_rows(tmp_path / "below") == {"set/a.bvh": [Row(1.0, 2.0, ACCENT, 1.0), Row(3.0, 4.5, "there", 0.8)]}
    (tmp_path / "gesture_units.csv").write_text(HEAD + "set/a.bvh,1,soon,0,,1\n")
    with pytest.raises(MotionError, match="line 2"):
        unit_rows(tmp_path)
    (tmp_path / "gesture_units.csv").write_text("file,start_s,concept\nset/a.bvh,1,\n")
    with pytest.raises(MotionError, match="lacks the column 'end_s'"):
        unit_rows(tmp_path)


def test_a_unit_is_cut_at_peoples_tempo():
    whole = swaying(300, 0.1)
    slow, fast = (cut_out(whole, Row(2.0, 4.0, ACCENT, tempo)) for tempo in (1.0, 2.0))
    np.testing.assert_allclose(slow.packed(), whole[60:121].packed(), atol=1e-6)
    assert len(fast) == 30
    np.testing.assert_allclose(fast.wrist[[0, -1]], slow.wrist[[0, -1]], atol=1e-6)
    with pytest.raises(MotionError, match="outside of its file"):
        cut_out(whole, Row(20.0, 21.0, ACCENT, 1.0))


@pytest.mark.parametrize("side", [0, 1])
def test_a_unit_begins_with_its_stroke_and_its_busy_hand(side: int):
    clips = [CapturedClip("a.0", "unit", "there", "set/a.bvh", "MIT", reaching(90, side=side))]
    (unit,) = gesture_units(CapturedLibrary(tuple(clips)))
    assert (unit.meaning, unit.is_both) == ("there", False)
    assert 1.3 < unit.seconds < 1.9
    rise = np.ptp(unit.hands[..., 1], axis=0)
    assert rise[0] > 0.25
    assert rise[1] == 0
    assert np.linalg.norm(np.diff(unit.hands[:2, 0, :3], axis=0)) * 30 > 0.1


def test_units_are_read_with_the_library(captured_folder: Path, tmp_path: Path):
    speech = next(captured_folder.rglob("cleo.bvh"))
    (tmp_path / "speech").mkdir()
    (tmp_path / "speech" / "cleo.bvh").write_bytes(speech.read_bytes())
    (tmp_path / "gesture_units.csv").write_text(HEAD + "speech/cleo.bvh,2,3,0,,1\nspeech/cleo.bvh,200,201,0,,1\n")
    (unit,) = read_folder(tmp_path).of("unit")
    assert (unit.name, unit.group, unit.source) == ("cleo.0", ACCENT, "speech/cleo.bvh")
    assert unit.seconds == pytest.approx(1.0, abs=0.05)
