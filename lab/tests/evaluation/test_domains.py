"""Who dances is told by the ankles, who gestures by the wrists."""

from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.evaluation import domains
from echoavatar_lab.evaluation.domains import (
    ANKLES,
    DANCING,
    HANDS,
    TALKING,
    WAITING,
    Pace,
    Person,
    as_text,
    danced_gestured,
    held_out,
    limits,
    pace,
    shares,
)
from echoavatar_lab.evaluation.takes import Sound, Take

CAPTURED = Path(__file__).parents[3] / "../shared/data/motion_permissive"


def moving(joint: str, degrees_s: float, frames: int = 150) -> Motion:
    """A body of which one joint rotates to and fro, half a second each way."""
    rotations = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    angle = np.radians(degrees_s) * np.abs((np.arange(frames) / 30 + 0.5) % 1 - 0.5)
    axis = 3 if "Arm" in joint else 1  # across the bone: arms lie along X
    rotations[:, HUMANOID.index(joint), 0] = np.cos(angle / 2)
    rotations[:, HUMANOID.index(joint), axis] = np.sin(angle / 2)
    return Motion(HUMANOID, rotations, np.zeros((frames, 3), np.float32), 30.0)


def test_the_pace_of_ankles_is_angle_times_leg() -> None:
    points = HUMANOID.rest_positions
    hip, ankle, head = (points[HUMANOID.index(name)] for name in ("leftUpperLeg", "leftFoot", "head"))
    expected = np.radians(90) * (hip - ankle)[1] * 1.5 / (head - ankle)[1] / 2  # one of two legs
    found = pace(moving("leftUpperLeg", 90))
    assert np.median(found.ankles) == pytest.approx(expected, rel=0.15)  # it turns back twice a second
    assert found.hands.max() < 1e-6


def test_legs_that_travel_dance_and_arms_alone_gesture() -> None:
    for joint, speed, expected in (
        ("hips", 0, (False, False)),
        ("leftUpperLeg", 150, (True, False)),
        ("leftUpperLeg", 45, (False, False)),
        ("rightUpperArm", 60, (False, True)),
    ):
        danced, gestured = danced_gestured(pace(moving(joint, speed)))
        assert (danced.all(), danced.any(), gestured.all(), gestured.any()) == tuple(np.repeat(expected, 2)), joint


@pytest.mark.parametrize(("speed", "is_gestured"), [(0.115, False), (0.125, True)])
def test_wrists_gesture_from_012_arm_lengths_a_second(speed: float, is_gestured: bool) -> None:
    """One straight arm turns about its shoulder, at twice the speed, and the other hangs: the mean counts."""
    motion = moving("rightUpperArm", 0)
    angle, arm = 2 * speed * np.arange(motion.frames) / motion.fps, HUMANOID.index("rightUpperArm")
    motion.rotations[:, arm, 0], motion.rotations[:, arm, 3] = np.cos(angle / 2), np.sin(angle / 2)
    danced, gestured = (marks[45:-45] for marks in danced_gestured(pace(motion)))  # the smoothing slows the ends
    assert not danced.any()
    assert (gestured.all(), gestured.any()) == (is_gestured, is_gestured)


def test_shares_by_class_and_kind() -> None:
    takes = [
        Take("a", "speech", "male, read", moving("leftUpperLeg", 150, 100)),
        Take("b", "speech", "female, read", moving("leftUpperArm", 90, 300)),
    ]
    found = {row.group: row for row in shares(takes)}
    assert (found["all"].danced, found["all"].gestured, found["all"].takes) == (0.25, 0.75, 2)
    assert (found["male, read"].danced, found["female, read"].danced) == (1, 0)
    assert "| speech | all | 2 | 13 | 25.0 [0.0, 100.0] | 75.0 [0.0, 100.0] |" in as_text(shares(takes))
    assert "| speech | male, read | 1 | 3 | 100.0 | 0.0 |" in as_text(shares(takes))


def test_takes_of_one_sound_are_one_sample() -> None:
    """Performed twice, a sound is still one sound: the interval is over sounds, not over takes."""
    takes = [Take("a", "speech", "x", moving("hips", 0, 90)), Take("a", "speech", "x", moving("leftUpperLeg", 150, 90))]
    (whole, _) = shares(takes)
    assert (whole.takes, whole.danced) == (2, 0.5)
    assert np.isnan(whole.danced_interval.low)
    more = [*takes, Take("b", "speech", "x", moving("hips", 0, 90)), Take("b", "speech", "x", moving("hips", 0, 90))]
    assert shares(more)[0].danced_interval == (0, 0.5)


def person(performer: str, kind: str, ankles: float, hands: float) -> Person:
    return Person(performer, kind, Pace(np.full(90, ankles), np.full(90, hands)), 3.0)


def test_limits_lie_between_the_kinds_and_nobody_is_judged_by_his_own() -> None:
    people = [
        person("a", WAITING, 0.0, 0.05),
        person("b", WAITING, 0.1, 0.05),
        person("c", TALKING, 0.1, 0.4),
        person("d", TALKING, 0.9, 0.5),  # walks about: the others call that a dance
        person("e", DANCING, 0.8, 1.0),
        person("f", DANCING, 1.2, 1.0),
    ]
    found = limits([one for one in people if one.performer != "d"])
    assert 0.1 <= found.ankles < 0.8
    assert 0.05 <= found.hands < 0.4
    rows = {row.group: row for row in held_out(people)}
    assert (rows[WAITING].danced, rows[WAITING].gestured) == (0, 0)
    assert (rows[TALKING].danced, rows[TALKING].gestured) == (0.5, 0.5)
    assert rows[DANCING].danced >= 0.5


def test_people_are_read_by_what_their_path_says(tmp_path: Path) -> None:
    for name in ("idle/a_1", "talks/b_1", "dance/c_1", "other/d_1"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        motion = moving("leftUpperLeg", 30, 75)
        write_bvh(tmp_path / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    found = domains.read_people(tmp_path)
    assert [(one.performer, one.kind) for one in found] == [
        ("dance/c", DANCING),
        ("idle/a", WAITING),
        ("talks/b", TALKING),
    ]
    (tmp_path / "dance/c_1.bvh").unlink()
    with pytest.raises(EchoAvatarError, match="holds nobody dancing .*docs/metrics"):
        domains.read_people(tmp_path)


@pytest.mark.slow
def test_the_limits_are_those_of_captured_people_who_do_not_know_them() -> None:
    if not CAPTURED.is_dir():
        pytest.skip(f"{CAPTURED} is not here")
    people = domains.read_people(CAPTURED)
    assert limits(people) == pytest.approx((ANKLES, HANDS), abs=0.03)
    rows = {row.group: row for row in held_out(people)}
    assert max(rows[WAITING].danced, rows[TALKING].danced) < 0.02
    assert rows[DANCING].danced > 0.65  # 0.70 of these few dancers


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"speaker_or_artist": "LibriSpeech 1 (M, Ann)", "language_or_genre": "English, read book"}, "male, read book"),
        ({"speaker_or_artist": "EmoDB 03 (m31)", "language_or_genre": "German, acted emotion", "title": "x anger"},
         "male, acted anger"),
        ({"speaker_or_artist": "EmoDB 09 (f21)", "language_or_genre": "German, acted emotion", "title": "x fear"},
         "female, acted, other emotions"),
        ({"speaker_or_artist": "pim", "language_or_genre": "nl_NL, read prompt"}, "sex not told, read prompt"),
        ({"kind": "music", "speaker_or_artist": "A (M)", "language_or_genre": "jazz [excerpt]"}, "jazz"),
    ],
)  # fmt: skip
def test_classes_of_voices(row: dict[str, str], expected: str) -> None:
    assert domains.voice({"kind": "speech"} | row) == expected


def test_speech_over_music_is_as_loud_as_the_speech(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(0)
    sounds = [Sound("a", "speech", "male, read", noise.normal(0, 0.1, 500).astype(np.float32))]
    sounds.append(Sound("b", "music", "jazz", noise.normal(0, 0.7, 400).astype(np.float32)))
    monkeypatch.setattr(domains.takes, "read_sounds", lambda *_, **__: list(sounds))
    *kept, loud, quiet = domains.read_sounds(Path(), 1, 1)
    assert kept == sounds
    for mixed, below, music in ((loud, 0, 0.5), (quiet, 12, 0.06)):  # the music's share of the power
        assert (mixed.kind, mixed.group, len(mixed.audio)) == ("both", domains.spoken_over(below), 400)
        assert np.std(mixed.audio) == pytest.approx(0.1, rel=0.15)
        assert np.corrcoef(mixed.audio, sounds[1].audio)[0, 1] ** 2 == pytest.approx(music, abs=0.06)
