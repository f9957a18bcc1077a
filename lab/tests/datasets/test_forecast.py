import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, write_beat2, write_motion, write_pair

from echoavatar.errors import MotionError
from echoavatar_lab.datasets.forecast import forecast, motion_header, sound_seconds
from echoavatar_lab.datasets.options import Options
from echoavatar_lab.datasets.source import survey_of


def test_headers_tell_frames_rate_and_length(tmp_path):
    path = write_pair(tmp_path / "a.bvh", 2.0, fps=60)
    frames, fps = motion_header(path)
    assert (frames, round(fps)) == (120, 60)
    assert sound_seconds(path.with_suffix(".wav")) == pytest.approx(2.0, abs=1e-3)
    assert motion_header(write_beat2(tmp_path, "1_a_0", 2.0)) == (60, 30.0)


def test_a_forecast_names_what_will_fail_and_writes_nothing(tmp_path):
    for name in ("good", "mute", "torn", "slow"):
        write_pair(tmp_path / f"{name}.bvh", 2.0)
    (tmp_path / "mute.wav").unlink()
    (tmp_path / "torn.bvh").write_text("HIERARCHY\nROOT Hips\n{\n")
    slow = tmp_path / "slow.bvh"
    slow.write_text(slow.read_text().replace("Frame Time: 0.016666667", "Frame Time: 0.033333333"))
    before = sorted(tmp_path.rglob("*"))
    found = forecast(survey_of("bvh", tmp_path).recordings, Options(test_every=0))
    assert sorted(tmp_path.rglob("*")) == before
    assert found.clips == {"train": 1}
    assert found.seconds["train"] == pytest.approx(2.0, abs=0.01)
    why = dict(found.failures)
    assert "mute.wav is missing" in why["mute"]
    assert "is incomplete" in why["torn"]
    assert "lasts 4.0 s at 30" in why["slow"]
    assert found.bytes == pytest.approx(60 * (52 * 16 + 13 + 1600), rel=0.02)


def test_a_forecast_of_motion_alone_counts_no_sound(tmp_path):
    write_motion(tmp_path / "a.bvh", gesture(1.0))
    for sound in ("any", "none"):
        found = forecast(survey_of("bvh", tmp_path).recordings, Options(sound=sound))
        assert found.bytes == pytest.approx(30 * (52 * 16 + 13), rel=0.05)


def test_files_with_invalid_headers_are_named(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.zeros(3))
    (tmp_path / "b.bvh").write_bytes(b"\xff\xfe\x00")
    for name in ("a.npz", "b.bvh", "gone.bvh"):
        with pytest.raises(MotionError, match=name):
            motion_header(tmp_path / name)
    (tmp_path / "c.wav").write_text("no sound")
    with pytest.raises(MotionError, match="c.wav is not a sound file"):
        sound_seconds(tmp_path / "c.wav")
