import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, write_beat2, write_motion, write_pair
from tests.models.audio.sounds import encode, talk

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.audio.files import open_sound
from echoavatar_lab.data import Corpus
from echoavatar_lab.datasets import prepare_dataset as dataset_module
from echoavatar_lab.datasets import prepare_recording as recording_module
from echoavatar_lab.datasets.layouts import survey_of
from echoavatar_lab.datasets.prepare_dataset import forecast, motion_header, prepare, sound_seconds, split_source
from echoavatar_lab.datasets.source import SetOptions, with_splits

KEEP = SetOptions(fingers="keep")


@pytest.fixture
def takes(tmp_path):
    """Three good recordings and four with different errors."""
    folder = tmp_path / "takes"
    for name in ("good1", "good2", "good3", "torn", "mute", "slow", "noise"):
        write_pair(folder / f"{name}.bvh", 1.0)
    torn = folder / "torn.bvh"
    text = torn.read_text()
    torn.write_text(text[:-9000] + text[-8900:])
    (folder / "mute.wav").unlink()
    slow = folder / "slow.bvh"
    slow.write_text(slow.read_text().replace("Frame Time: 0.016666667", "Frame Time: 0.033333333"))
    (folder / "noise.wav").write_bytes(b"this is no sound")
    return folder


def test_bad_recordings_are_named_and_do_not_stop_the_others(takes, tmp_path):
    seen = []
    survey, folder = survey_of("bvh", takes), tmp_path / "set"
    outcome = prepare("bvh", survey, folder, KEEP, progress=lambda done, total: seen.append((done, total)))
    assert outcome.made == ("good1", "good2", "good3")
    why = dict(outcome.failures)
    assert set(why) == {"torn", "mute", "slow", "noise"}
    assert "torn.bvh" in why["torn"]
    assert "fetch it again" in why["torn"]
    assert "mute.wav is missing" in why["mute"]
    assert "would fit at 60" in why["slow"]
    assert "noise.wav is not a sound file" in why["noise"]
    assert seen == [(n, 7) for n in range(1, 8)]
    report = json.loads((tmp_path / "set" / "report.json").read_text())
    assert report["state"] == "finished"
    assert report["failed"] == why
    outcome.corpus.verify()


def test_a_corrected_recording_is_added_by_the_same_call(takes, tmp_path):
    prepare("bvh", survey_of("bvh", takes), tmp_path / "set", KEEP)
    write_pair(takes / "torn.bvh", 1.0)
    outcome = prepare("bvh", survey_of("bvh", takes), tmp_path / "set", KEEP)
    assert outcome.made == ("torn",)
    assert outcome.kept == ("good1", "good2", "good3")
    assert outcome.corpus.names(has_mirrored=False) == ["good1", "good2", "good3", "torn"]
    outcome.corpus.verify()


def test_an_interrupted_run_is_continued_without_doing_things_twice(takes, tmp_path, monkeypatch):
    """Ctrl-C after the second recording: two are written, and are not made again."""

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    survey = survey_of("bvh", takes, only=["good*"])
    with pytest.raises(KeyboardInterrupt):
        prepare("bvh", survey, tmp_path / "set", KEEP, progress=stop)
    report = json.loads((tmp_path / "set" / "report.json").read_text())
    assert report["state"] == "interrupted"
    assert report["made"] == ["good1", "good2"]
    assert Corpus(tmp_path / "set").names(has_mirrored=False) == ["good1", "good2"]
    asked = []
    monkeypatch.setattr(
        dataset_module,
        "prepare_recording",
        lambda one, *rest: asked.append(one.name) or recording_module.prepare_recording(one, *rest),
    )
    outcome = prepare("bvh", survey, tmp_path / "set", KEEP)
    assert asked == ["good3"]
    assert outcome.kept == ("good1", "good2")
    assert outcome.made == ("good3",)


def test_a_killed_run_leaves_parts_that_the_next_one_packs(tmp_path):
    """After SIGKILL, finished receipts must be used and incomplete files must not."""
    takes, made = tmp_path / "takes", tmp_path / "set"
    for number in range(6):
        write_pair(takes / f"t{number}.bvh", 1.0)
    call = [sys.executable, "-m", "echoavatar", "data", "prepare", "bvh", str(takes), "-o", str(made)]
    running = subprocess.Popen(
        [*call, "--workers", "1", "--no-pictures", "--fingers", "keep"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 60
    while not list(made.glob("parts/*.json")) and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    receipts = list(made.glob("parts/*.json"))
    assert receipts, "nothing was finished before the kill"
    assert not (made / "manifest.json").exists(), "killed too late to prove anything"
    (made / "parts" / "t5.npz").write_bytes(b"torn")
    (made / "parts" / "t5.json").write_text('{"name"')
    outcome = prepare("bvh", survey_of("bvh", takes), made, KEEP)
    assert len(outcome.made) == 6
    assert not outcome.failures
    outcome.corpus.verify()


def test_parts_made_with_other_options_are_not_used(tmp_path):
    """A part of a killed run is not used by a call with other options."""
    write_pair(tmp_path / "takes" / "a.bvh", 1.0)
    survey = survey_of("bvh", tmp_path / "takes")
    recording_module.prepare_recording(with_splits(survey.recordings, 0)[0], KEEP, tmp_path / "set")
    outcome = prepare("bvh", survey, tmp_path / "set", SetOptions(rig="native", fingers="keep"))
    assert outcome.receipts["a"].fidelity == {}


def test_an_unexpected_error_affects_one_recording(takes, tmp_path, monkeypatch):
    def strange(one, *rest):
        if one.name == "good2":
            raise ZeroDivisionError("somewhere deep")
        return recording_module.prepare_recording(one, *rest)

    monkeypatch.setattr(dataset_module, "prepare_recording", strange)
    outcome = prepare("bvh", survey_of("bvh", takes, only=["good*"]), tmp_path / "set", KEEP)
    assert outcome.made == ("good1", "good3")
    assert outcome.failures == (("good2", "unexpected, please report it: ZeroDivisionError: somewhere deep"),)


def test_nothing_at_all_is_an_error_that_says_why(takes, tmp_path):
    with pytest.raises(EchoAvatarError, match=r"none of 1 recordings .*mute.wav is missing"):
        prepare("bvh", survey_of("bvh", takes, only=["mute"]), tmp_path / "set", KEEP)
    report = json.loads((tmp_path / "set" / "report.json").read_text())
    assert list(report["failed"]) == ["mute"]


def test_a_place_that_cannot_be_written_is_named(takes, tmp_path):
    (tmp_path / "set").write_text("a file")
    with pytest.raises(EchoAvatarError, match="choose another place"):
        prepare("bvh", survey_of("bvh", takes), tmp_path / "set", KEEP)


@pytest.mark.slow
def test_the_same_recordings_give_the_same_set_on_any_number_of_workers(takes, tmp_path):
    """New fingers follow from seed and name, so the number of workers does not matter; neither for failures."""
    one, two = (
        prepare("bvh", survey_of("bvh", takes), tmp_path / f"set{n}", SetOptions(fingers="all"), workers=n)
        for n in (1, 2)
    )
    assert one.corpus.manifest.shards[0].sha256 == two.corpus.manifest.shards[0].sha256
    assert [failure.name for failure in one.failures] == [failure.name for failure in two.failures]


def test_the_split_is_described(takes):
    survey = survey_of("bvh", takes)
    assert split_source(survey, KEEP) == "every tenth by name"
    assert split_source(survey, KEEP.model_copy(update={"test_every": 3})) == "one in 3 by name"
    assert split_source(survey, KEEP.model_copy(update={"test_every": 0})) == "nothing held out"


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
    found = forecast(survey_of("bvh", tmp_path).recordings, SetOptions(test_every=0))
    assert sorted(tmp_path.rglob("*")) == before
    assert found.clips == {"train": 1}
    assert found.seconds["train"] == pytest.approx(2.0, abs=0.01)
    why = dict(found.failures)
    assert "mute.wav is missing" in why["mute"]
    assert "it was cut short" in why["torn"]
    assert "lasts 4.0 s at 30" in why["slow"]
    assert found.bytes == pytest.approx(60 * (52 * 16 + 13 + 1600), rel=0.02)


def test_a_forecast_reads_what_the_run_reads(tmp_path):
    """Motion without a frame time or a count, in another encoding; sound that was recorded live."""
    for name in ("timeless", "countless", "shift_jis", "live"):
        write_pair(tmp_path / f"{name}.bvh", 2.0, fps=30)
    for name, old, new in (
        ("timeless", "Frame Time: 0.033333333", "Frame Time: 0"),
        ("countless", "Frames: 60", "Frames: 0"),
        ("shift_jis", "ROOT hips", "ROOT 腰"),
    ):
        text = (tmp_path / f"{name}.bvh").read_text()
        assert old in text
        (tmp_path / f"{name}.bvh").write_text(text.replace(old, new), encoding="shift_jis")
    live = {"container": "webm", "options": {"live": "1"}}
    sound = encode(tmp_path / "live.weba", "libopus", talk(48_000), 48_000, **live)
    assert open_sound(sound).duration is None
    (tmp_path / "live.wav").unlink()
    found = forecast(survey_of("bvh", tmp_path).recordings, SetOptions(test_every=0))
    assert found.failures == ()
    assert found.seconds["train"] == pytest.approx(8.0, abs=0.1)


def test_a_forecast_of_motion_alone_counts_no_sound(tmp_path):
    write_motion(tmp_path / "a.bvh", gesture(1.0))
    for sound in ("any", "none"):
        found = forecast(survey_of("bvh", tmp_path).recordings, SetOptions(sound=sound))
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
