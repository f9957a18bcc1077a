import json
import os
import signal
import subprocess
import sys
import time

import pytest
from lab.tests.datasets.samples import write_pair

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.data import Corpus
from echoavatar_lab.datasets import prepare_dataset as dataset_module
from echoavatar_lab.datasets import prepare_recording as recording_module
from echoavatar_lab.datasets.options import Options
from echoavatar_lab.datasets.prepare_dataset import prepare, split_source
from echoavatar_lab.datasets.source import survey_of, with_splits

KEEP = Options(fingers="keep")


@pytest.fixture
def takes(tmp_path):
    """Three good recordings and four with different errors."""
    folder = tmp_path / "takes"
    for name in ("good1", "good2", "good3", "torn", "mute", "slow", "noise"):
        write_pair(folder / f"{name}.bvh", 1.0)
    torn = folder / "torn.bvh"
    torn.write_text(torn.read_text()[:-300])
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
    outcome = prepare("bvh", survey, tmp_path / "set", Options(rig="native", fingers="keep"))
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
    with pytest.raises(EchoAvatarError, match="choose another -o"):
        prepare("bvh", survey_of("bvh", takes), tmp_path / "set", KEEP)


@pytest.mark.slow
def test_the_same_recordings_give_the_same_set_on_any_number_of_workers(takes, tmp_path):
    """New fingers follow from seed and name, so the number of workers does not matter; neither for failures."""
    one, two = (
        prepare("bvh", survey_of("bvh", takes), tmp_path / f"set{n}", Options(fingers="all"), workers=n) for n in (1, 2)
    )
    assert one.corpus.manifest.shards[0].sha256 == two.corpus.manifest.shards[0].sha256
    assert [failure.name for failure in one.failures] == [failure.name for failure in two.failures]


def test_the_split_is_described(takes):
    survey = survey_of("bvh", takes)
    assert split_source(survey, KEEP) == "every tenth by name"
    assert split_source(survey, KEEP.model_copy(update={"test_every": 3})) == "one in 3 by name"
    assert split_source(survey, KEEP.model_copy(update={"test_every": 0})) == "nothing held out"
