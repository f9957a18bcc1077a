import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, SPEECH, clip, folder
from lab.tests.evaluation.test_takes import captured, write_sound
from tests.motion.kinematics.samples import swaying

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.motion.formats.tables import write_npz
from echoavatar_lab.align.targets import GOALS
from echoavatar_lab.evaluation.jury import Verdict, as_json, as_text, read_moving, verdicts
from echoavatar_lab.evaluation.metrics.tells import HEARD, TELLS
from echoavatar_lab.evaluation.onlooker import CONTROL, OURS, told_apart
from echoavatar_lab.evaluation.paid_for import LEGEND, PAID_FOR, marked
from echoavatar_lab.evaluation.table import UNKNOWN
from echoavatar_lab.evaluation.takes import Take


def take(name: str, size: float, kind: str = "speech") -> Take:
    return Take(name, kind, "", swaying(400, size=size))


def test_rows_further_outside_come_first() -> None:
    people = [take("ann", 0.2), take("bob", 0.3)]
    rows = verdicts([take("a", 0.6), take("b", 0.65)], people, 30)["speech"]
    assert [row.outside for row in rows[:29]] == sorted((row.outside for row in rows[:29]), reverse=True)
    assert {row.name for row in rows} == {*TELLS, *HEARD}
    fast = next(row for row in rows if row.name == "stroke: speed, 95 %")
    assert fast.low < fast.median < fast.high < fast.interval.low < fast.ours < fast.interval.high
    assert fast.outside == pytest.approx((fast.ours - fast.high) / ((fast.high - fast.low) / 2), rel=1e-6)
    among = verdicts([take("ann", 0.2), take("bob", 0.3)], people, 30)["speech"]
    assert not any(row.is_outside for row in among)


def test_a_little_outside_is_inside() -> None:
    assert not Verdict("", 0, 0, 0, 0, UNKNOWN, 0.03).is_outside
    assert Verdict("", 0, 0, 0, 0, UNKNOWN, 0.031).is_outside
    assert not Verdict("", 0, 0, 0, 0, UNKNOWN, float("nan")).is_outside


def test_one_person_makes_no_range_and_performances_of_a_clip_are_one_clip() -> None:
    found = verdicts([take("a", 0.2), take("a", 0.4)], [take("ann", 0.2)], 30)
    assert all(np.isnan(row.outside) and np.isnan(row.interval.low) for row in found["speech"])
    assert as_json(found, {})["speech"]["of"] == 0
    means = [verdicts([take("a", size)], [], 30)["speech"] for size in (0.2, 0.4)]
    by_name = [{row.name: row.ours for row in rows} for rows in means]
    for row in found["speech"]:
        assert row.ours == pytest.approx(np.mean([own[row.name] for own in by_name]), nan_ok=True)


def test_captured_people_in_our_place_are_judged_as_ours_are() -> None:
    """Who has the clips that we have is told as often as we are; without them nothing is said."""
    ours, judges = [take("a", 0.2), take("b", 0.3)], [take("ann", 0.5), take("eve", 0.7)]
    told = told_apart(ours, judges, [one._replace(group="joe") for one in ours])
    assert told[CONTROL].accuracy == told[OURS].accuracy
    assert 0 <= told_apart(ours, judges, ours[:1])[CONTROL].accuracy <= 1  # one clip, in four stretches
    assert CONTROL not in told_apart(ours, judges)


def test_a_take_that_cannot_be_judged_is_named() -> None:
    short = Take("my take", "speech", "", swaying(15))
    with pytest.raises(MotionError, match=r"my take: 0\.50 s of motion"):
        verdicts([short], [], 30)
    with pytest.raises(MotionError, match=r"my take: 0\.50 s of motion"):
        told_apart([short], [take("ann", 0.2)])


def test_a_corpus_is_judged_by_its_stretches_of_speech_and_music(tmp_path: Path) -> None:
    mixed = clip("a", 900)
    mixed.domain[:] = np.repeat([SPEECH, 0, SPEECH, MUSIC, SPEECH], [200, 50, 150, 330, 170])
    folder(tmp_path, [mixed, clip("b", 320, kind=MUSIC, split="train"), clip("c", 320)], is_corpus=True)
    found = read_moving(tmp_path, 2)
    assert [(one.name, one.kind, one.motion.frames) for one in found] == [
        ("a", "speech", 400),
        ("a", "music", 330),
        ("b", "music", 320),
    ]
    assert found[1].audio is not None
    np.testing.assert_allclose(found[1].audio, mixed.audio[400 * 800 : 730 * 800], atol=2**-15)
    short = folder(tmp_path / "short", [clip("a", 90)], is_corpus=True)
    with pytest.raises(EchoAvatarError, match="no 10 s of speech or music in its first 5 clips"):
        read_moving(short, 5)


def test_a_folder_of_takes_is_told_by_names(tmp_path: Path) -> None:
    for name in ("my_dance", "talk"):
        write_npz(tmp_path / f"{name}.npz", swaying(60))
    assert [(one.name, one.kind) for one in read_moving(tmp_path, 5)] == [("my_dance", "music"), ("talk", "speech")]


def test_the_command_performs_or_judges_and_ends_with_json(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    people = ["--captured", str(captured(tmp_path / "people"))]
    asked = ["evaluate", str(tiny_bundle), "jury", *people]
    assert main(asked) == 1
    assert "--recordings" in capsys.readouterr().err
    write_sound(tmp_path / "sounds/voice.wav", 5)
    judged = ["--judges", str(tmp_path / "people")]
    sounds = ["--recordings", str(tmp_path / "sounds"), "--seconds", "5", "--repeats", "2"]
    assert main([*asked, *sounds, *judged]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    told = json.loads(said[-1])["speech"]
    assert told["of"] == 31
    assert set(told["rows"]) == {*TELLS, *HEARD}
    assert {name for name, row in told["rows"].items() if row["paid_for"]} == set(TELLS)
    assert 0 <= told["told_apart"]["ours"]["accuracy"] <= 1
    assert LEGEND in said
    assert main([*asked, "--motion", str(tmp_path / "people")]) == 0
    assert set(json.loads(capsys.readouterr().out.splitlines()[-1])) == {"speech", "music", "strokes"}


def test_every_target_of_the_alignment_is_marked() -> None:
    """A target's measure and the row that shows it may differ in name."""
    rows = {"beats": "ba_beat", "stresses": "ba_onset", "rest": "silence_hand_speed_ratio"}
    measures = {name.rpartition(".")[2] for name in GOALS} | {"told_apart"}
    assert {rows.get(name, name) for name in measures} <= PAID_FOR
    assert [marked(name) for name in ("hand_speed", "recordings_ba_beat", "skate")] == [
        "hand_speed*",
        "recordings_ba_beat*",
        "skate",
    ]


def test_marks_are_printed() -> None:
    found = {"speech": [Verdict("hand_speed", 0, 1, 2, 3, UNKNOWN, 1.0)]}
    assert as_text(found, {}).splitlines()[1].startswith("hand_speed* ")
    assert as_json(found, {})["speech"]["rows"]["hand_speed"]["paid_for"] is True
