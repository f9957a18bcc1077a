"""Answers: durable, once, by the right person, whatever the page does. On SQLite and on PostgreSQL."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.errors import StudioError
from echoavatar_studio.judging import media_path
from echoavatar_studio.making import Maker
from echoavatar_studio.tables import Judgement


def count(maker: Maker) -> int:
    with maker.store.read() as session:
        return session.query(Judgement).count()


def test_a_repeated_answer_is_kept_once(either: Maker, library):
    study = canned.make_pairwise(either, library)
    rater = RaterPerson(app_of(either)).begin(tokens(either, study, 1)[0])
    task = rater.task()
    first, again = (rater.answer(task, key="same-key-1") for _ in range(2))
    assert (first.json()["is_repeated"], again.json()["is_repeated"]) == (False, True)
    assert first.json()["progress"] == again.json()["progress"]
    other = rater.answer(task, key="same-key-1", seconds=9.0)
    assert (other.status_code, other.json()["code"]) == (409, "key_reused")
    second_tab = rater.answer(task, key="other-key-1")
    assert (second_tab.status_code, second_tab.json()["code"]) == (409, "already_judged")
    key_of_before = rater.answer(rater.task(), key="same-key-1")
    assert key_of_before.json()["code"] == "key_reused"
    assert count(either) == 1


def test_double_clicks_and_tabs_at_the_same_moment(either: Maker, library):
    """Twenty submissions of one task at once, half of them with one key: one is kept."""
    study = canned.make_pairwise(either, library)
    rater = RaterPerson(app_of(either)).begin(tokens(either, study, 1)[0])
    task = rater.task()

    def submit(number: int) -> str:
        answer = rater.answer(task, key="shared-key" if number % 2 else f"own-key-{number}")
        body = answer.json()
        return body.get("code") or ("repeated" if body["is_repeated"] else "saved")

    with ThreadPoolExecutor(10) as pool:
        said = list(pool.map(submit, range(20)))
    assert said.count("saved") == 1
    assert set(said) <= {"saved", "repeated", "already_judged"}
    assert count(either) == 1


def test_raters_at_the_same_time_do_not_meet(either: Maker, library):
    study, app = canned.make_pairwise(either, library, raters=5), app_of(either)
    links = tokens(either, study, 5)

    def work(token: str) -> int:
        rater, done = RaterPerson(app).begin(token), 0
        while (task := rater.task()) is not None:
            assert rater.answer(task).status_code == 200
            done += 1
        return done

    with ThreadPoolExecutor(5) as pool:
        assert list(pool.map(work, links)) == [9] * 5
    assert count(either) == 45


def test_another_device_goes_on_where_the_first_was(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    token = tokens(maker, study, 1)[0]
    phone = RaterPerson(app).begin(token)
    phone.answer(phone.task())
    waiting = phone.task()
    desktop = RaterPerson(app)
    joined = desktop.join(token).json()
    assert (joined["has_consented"], joined["progress"]["done"]) == (True, 1)
    assert desktop.task() == waiting == phone.task()
    ahead = phone.get("/api/rater/task").json()["ahead"]
    assert ahead["number"] == waiting["number"] + 1
    assert phone.get(ahead["clips"][0]).status_code == 200


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plays": [1]}, "plays has 1 numbers"),
        ({"plays": [0, 1]}, "every clip must be played"),
        ({"ratings": {"human_likeness": 1}}, "ratings must answer"),
        ({"ratings": {"human_likeness": 3, "beat_matching": 0, "overall_preference": 0}}, "the body is not valid"),
        ({"ratings": {"human_likeness": 1.5, "beat_matching": 0, "overall_preference": 0}}, "the body is not valid"),
        ({"seconds": -1}, "the body is not valid"),
        ({"seconds": "NaN"}, "the body is not valid"),
        ({"extra": 1}, "the body is not valid"),
    ],
)
def test_answers_that_do_not_fit_are_refused(maker: Maker, library, changes, message):
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    refused = rater.answer(rater.task(), **changes)
    assert (refused.status_code, refused.json()["code"]) == (400, "bad_request")
    assert message in refused.json()["message"]
    assert count(maker) == 0


def test_preference_answers_fit_preference_tasks(maker: Maker):
    study = canned.make_preference(maker)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    task = rater.task()
    for changes in ({"best": 3, "worst": 3}, {"best": 8}, {"best": -1}, {"type": "pairwise"}):
        assert rater.answer(task, **changes).json()["code"] == "bad_request", changes
    skip = {"type": "skip", "reason": "no_difference", "seconds": 3, "plays": [1] * 8}
    path = f"/api/rater/tasks/{task['id']}/answer"
    assert rater.post(path, skip, idempotency_key="skip-key").status_code == 200
    assert count(maker) == 1


def test_a_pairwise_task_is_skipped_only_where_a_clip_does_not_play(maker: Maker, library):
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    path = f"/api/rater/tasks/{rater.task()['id']}/answer"
    skip = {"type": "skip", "reason": "no_difference", "seconds": 3, "plays": [1, 1]}
    assert rater.post(path, skip, idempotency_key="skip-key").json()["code"] == "bad_request"
    broken = skip | {"reason": "cannot_play", "plays": [0, 0]}
    assert rater.post(path, broken, idempotency_key="skip-key").status_code == 200


def test_media_never_leaves_its_folder(tmp_path):
    with pytest.raises(StudioError):
        media_path(tmp_path, "../secret")
