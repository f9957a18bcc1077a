import json
import math
from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.test_takes import captured, corpus
from tests.motion.kinematics.samples import swaying

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation import alive
from echoavatar_lab.evaluation.alive import draw, sheet
from echoavatar_lab.evaluation.metrics.liveliness import KINDS, STATISTICS
from echoavatar_lab.evaluation.people import of_card, read_people
from echoavatar_lab.evaluation.takes import Take, read_sounds


def test_a_whole_run(tiny_bundle: Path, tmp_path: Path) -> None:
    """Every kind is performed, measured by class, and set beside people and captured motion."""
    sounds = read_sounds(corpus(tmp_path), 12, 2)
    takes = alive.performance(Pipeline(load_bundle(str(tiny_bundle))), sounds, 12)
    assert {take.kind for take in takes} == set(KINDS)
    found = alive.report([takes], read_people(captured(tmp_path)), 12)
    assert {"speech: English, female", "music: jazz", "speech, people", "silence, people"} <= set(found.rows)
    talkers = [found.rows[f"speech, people: {who}"]["hand_speed"] for who in ("ann", "bob")]
    assert found.rows["speech, people"]["hand_speed"] == pytest.approx(np.mean(talkers))
    assert found.rows["silence, people"]["hand_speed"] == of_card()["silence"]["hand_speed"].mean  # nobody waits here
    assert set(found.rows["silence"]) == {*alive.SHOWN, "stillest", *alive.RESTING}
    assert found.frechet["speech"] > 0
    assert 0 <= found.told_apart["speech"] <= 1
    assert math.isnan(found.told_apart["music"])  # one captured dance
    told = json.loads(json.dumps(alive.as_json(found), allow_nan=False))
    assert told["told_apart"]["music"] is None
    assert alive.as_text(found).splitlines()[1].startswith("speech ")


def test_captured_people_are_told_from_one_another_by_folder() -> None:
    random = np.random.default_rng(0)

    def person(folder: str, clips: int, level: float) -> list[alive.Measured]:
        return [
            alive.Measured(
                Take(f"{folder}/{clip}", "speech", folder, None),  # type: ignore[arg-type]
                [],
                [dict(zip(STATISTICS, random.normal(level, 1, len(STATISTICS)), strict=True)) for _ in range(20)],
            )
            for clip in range(clips)
        ]

    assert alive.people_apart(person("ann", 1, 0) + person("bob", 3, 9)) == 1
    assert alive.people_apart(person("ann", 3, 0) + person("bob", 3, 0)) < 0.7
    assert math.isnan(alive.people_apart(person("ann", 3, 0)))
    apart = alive.each_apart(person("ann", 3, 0) + person("bob", 3, 0) + person("cid", 3, 9))
    assert apart["cid"] == 1
    assert set(apart) == {"ann", "bob", "cid"}


def test_which_statistic_tells_ours_from_captured() -> None:
    random = np.random.default_rng(0)

    def side(name: str, lean: float) -> list[alive.Measured]:
        rows = random.normal(0, 1, (3, 20, len(STATISTICS)))
        rows[..., list(STATISTICS).index("trunk_lean")] += lean
        return [
            alive.Measured(
                Take(f"{name}/{clip}", "music", name, None),  # type: ignore[arg-type]
                [],
                [dict(zip(STATISTICS, row, strict=True)) for row in windows],
            )
            for clip, windows in enumerate(rows)
        ]

    rows = alive.by_statistic([side("ours", 9)], side("ann", 0))
    assert rows["told apart by one"]["trunk_lean"] == 1
    assert max(value for name, value in rows["told apart by one"].items() if name != "trunk_lean") < 0.75
    assert rows["median"]["trunk_lean"] == pytest.approx(9, abs=0.7)
    assert rows["people, median"]["trunk_lean"] == pytest.approx(0, abs=0.7)
    assert alive.by_statistic([side("ours", 9)], []) == {}


def test_each_captured_person_has_a_row() -> None:
    people = [Take(f"{name}/1", "music", name, swaying(450, size=size)) for name, size in (("ann", 0.2), ("bob", 0.3))]
    found = alive.report([[Take("ours", "music", "", swaying(450, size=0.1))]], people, 12)
    assert {label for label in found.rows if ": " in label} == {"music, people: ann", "music, people: bob"}
    assert found.rows["music, people: bob"]["hand_speed"] > found.rows["music, people: ann"]["hand_speed"]
    assert "music, people: ann" in found.told_apart


def test_several_performances_give_means_and_their_scatter() -> None:
    def take(name: str, size: float) -> Take:
        return Take(name, "music", "jazz", swaying(750, size=size))

    captured = [take("ann", 0.2), take("bob", 0.3)]
    some, others = ([take(f"{size} {n}", size + 0.02 * n) for n in range(3)] for size in (0.1, 0.4))
    first, second = (alive.report([takes], captured, 12) for takes in (some, others))
    both = alive.report([some, others], captured, 12)
    sways = [found.rows["music"]["hip_sway"] for found in (first, second)]
    assert both.rows["music"]["hip_sway"] == pytest.approx(np.mean(sways))
    assert both.rows["music, scatter"]["hip_sway"] == pytest.approx(np.std(sways, ddof=1))
    distances = [found.frechet["music"] for found in (first, second)]
    assert both.frechet["music"] == pytest.approx(np.mean(distances))
    assert both.rows["music"]["stillest"] == max(found.rows["music"]["stillest"] for found in (first, second))
    alone = [found.rows["music, told apart by one"]["hip_sway"] for found in (first, second)]
    assert both.rows["music, told apart by one"]["hip_sway"] == pytest.approx(np.mean(alone))
    assert {"music, scatter"} == set(both.rows) - set(first.rows)
    assert "music, scatter" in both.told_apart


def test_motion_like_the_captured_one_is_no_distance_away() -> None:
    takes = [alive.measure(Take(f"{n}", "speech", "", swaying(600, size=0.1 + 0.05 * n)), 20) for n in range(6)]
    near, accuracy = alive.compare(takes, takes)
    assert near == pytest.approx(0, abs=1e-6)
    assert accuracy <= 0.5


def test_a_plot_and_a_row_of_stills_for_each_take(tmp_path: Path) -> None:
    takes = [Take(f"{n}", "speech", "", swaying(330)) for n in range(2)]
    draw(alive.report([takes], takes, 11), tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(alive.report([takes], [], 11), tmp_path / "none/plot.png")
    assert sheet(takes[:1]).shape == (130, 12 * 90, 3)
