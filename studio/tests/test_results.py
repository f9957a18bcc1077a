"""Results by hand: two raters, known answers."""

import pytest
from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.errors import StudioError
from echoavatar_studio.making import Maker
from echoavatar_studio.results import results
from echoavatar_studio.tables import Clip, System, Task, Trial

TWO = [{"name": name, "clips": name, "group": "Two"} for name in ("Alpha", "Beta")]


def judge_all(maker: Maker, study: str, ratings: list[int]) -> None:
    """Each rater gives Alpha against Beta the same rating everywhere."""
    with maker.store.read() as session:
        alpha = {c for (c,) in session.query(Clip.id).join(System, Clip.system_id == System.id).filter_by(name="Alpha")}
        sides = {}
        for task, trial in session.query(Task, Trial).join(Trial, Task.trial_id == Trial.id):
            shown = [trial.clips[place] in alpha for place in task.order]
            sides[task.public] = 1 if shown[1] else -1
    app = app_of(maker)
    for token, rating in zip(tokens(maker, study, len(ratings)), ratings, strict=True):
        rater = RaterPerson(app).begin(token)
        while (task := rater.task()) is not None:
            told = {"overall_preference": rating * sides[task["id"]]}
            assert rater.answer(task, ratings=told).status_code == 200


def test_two_raters_by_hand(maker: Maker, library):
    """Ratings 2 and 1 on two dance sounds and two gesture sounds: mean 1.5, s = 0.577, half = 3.182 * 0.577 / 2."""
    shape = {"systems": TWO, "questions": ["overall_preference"], "raters": 2, "tasks_per_rater": 4, "training": 0}
    study = canned.make_pairwise(maker, library, checks={"identical": 0, "corrupted": 0}, **shape)
    empty = results(maker.store, study)
    assert (empty.judgements, empty.rows, empty.ranking) == (0, (), ())
    judge_all(maker, study, [2, 1])
    found = results(maker.store, study)
    assert (found.judgements, found.raters) == (8, 2)
    rows = {(row.system, row.category): row.scores["overall_preference"] for row in found.rows}
    assert set(rows) == {(name, kind) for name in ("Alpha", "Beta") for kind in ("dance", "gesture")}
    assert rows["Alpha", "dance"].mean == 1.5
    assert rows["Beta", "dance"].mean == -1.5
    assert rows["Alpha", "dance"].half == pytest.approx(3.182446 * 0.5773503 / 2, rel=1e-6)
    assert rows["Alpha", "dance"].half_raters == pytest.approx(12.706205 * 0.7071068 / 2**0.5, rel=1e-6)
    assert [(row.system, row.rank) for row in found.ranking if row.category == "all"] == [("Alpha", 1), ("Beta", 2)]
    # four units with (2, 1) or, with the places the other way round, (-2, -1)
    assert found.agreement[0].units == 4


def test_studies_that_do_not_exist(maker: Maker):
    with pytest.raises(StudioError):
        results(maker.store, "none")
