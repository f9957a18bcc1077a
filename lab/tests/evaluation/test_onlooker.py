import math
from pathlib import Path

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics.motion import Motion
from echoavatar_lab.evaluation import onlooker
from echoavatar_lab.evaluation.metrics.tells import JUDGED, judged_points
from echoavatar_lab.evaluation.onlooker import OURS, PEOPLE, movement, read_judges, told_apart
from echoavatar_lab.evaluation.takes import Take


def takes(person: str, clips: int, speed: float, seed: int) -> list[Take]:
    """Clips that sway `speed` times as fast, from random instants."""
    random = np.random.default_rng(seed)
    starts = random.integers(0, 900, clips)
    whole = swaying(1300, 30.0 / speed)
    found = []
    for number, start in enumerate(starts):
        part = whole.cut(int(start), int(start) + 300)
        motion = Motion(part.skeleton, part.rotations, part.root, 30.0)
        found.append(Take(f"{person}/{number}", "speech", person, motion))
    return found


def test_other_movement_is_told_and_the_same_is_not() -> None:
    people = takes("ann", 6, 1.0, 0) + takes("bob", 6, 1.0, 1)
    other = told_apart(takes("", 6, 2.0, 2), people)
    assert list(other) == [OURS, PEOPLE, "ann", "bob"]
    assert other[OURS].accuracy > 0.95
    assert other[OURS].interval.low > 0.9
    same = told_apart(takes("", 6, 1.0, 2), people)
    assert same[OURS].accuracy < 0.75
    assert same[OURS].interval.low < same[OURS].accuracy < same[OURS].interval.high
    assert same[PEOPLE].accuracy == pytest.approx((same["ann"].accuracy + same["bob"].accuracy) / 2)


def test_nobody_is_on_both_sides_of_a_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each fit knows only windows of people whom it does not judge, and of other clips of ours."""
    seen: list[tuple[list[str], list[str]]] = []

    def folds(own, others, clips, persons, *, fitted):
        seen.append((sorted(set(clips)), sorted(set(persons))))
        return np.ones(len(own), bool), np.ones(len(others), bool)

    monkeypatch.setattr(onlooker, "held_out_right", folds)
    told_apart(takes("ours", 2, 1.0, 0), takes("ann", 3, 1.0, 1) + takes("bob", 3, 1.0, 2))
    assert seen[0] == (["ours/0", "ours/1"], ["ann", "bob"])
    assert seen[1] == (["ann/0", "ann/1", "ann/2"], ["bob/0", "bob/1", "bob/2"])  # one person is left: by clip


def test_a_single_clip_is_cut_in_quarters_and_a_single_window_says_nothing() -> None:
    lone = told_apart(takes("", 2, 2.0, 0), takes("ann", 1, 1.0, 1))
    assert lone[OURS].accuracy > 0.9
    assert list(lone) == [OURS]
    ours = takes("", 1, 2.0, 0)
    short = [one._replace(motion=one.motion.cut(0, 100)) for one in ours]
    assert math.isnan(told_apart(short, takes("ann", 3, 1.0, 1))[OURS].accuracy)
    assert told_apart([one._replace(motion=one.motion.cut(0, 60)) for one in ours], ours) == {}


def test_measures_of_the_rig_are_hidden() -> None:
    """Arms twice as long and a head joint elsewhere are the same movement."""
    points = judged_points(swaying(200))
    other = points.copy()
    for side in ("left", "right"):
        shoulder, elbow, hand = (JUDGED.index(side + bone) for bone in ("UpperArm", "LowerArm", "Hand"))
        other[:, [elbow, hand]] = points[:, [shoulder]] + 2 * (points[:, [elbow, hand]] - points[:, [shoulder]])
    other[:, JUDGED.index("head")] += points[:, JUDGED.index("head")] - points[:, JUDGED.index("neck")]
    np.testing.assert_allclose(movement(other), movement(points), atol=1e-8)
    assert movement(points).shape == (200, 40)


def test_judges_are_told_by_their_path(tmp_path: Path) -> None:
    for name, frames in (("ann/wave", 100), ("ann/idle_1", 100), ("bob/dance", 100), ("bob/short", 60)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        motion = swaying(frames)
        write_bvh(tmp_path / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    assert [(take.group, take.kind) for take in read_judges(tmp_path)] == [("ann", "speech"), ("bob", "music")]
