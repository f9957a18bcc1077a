"""Whole studies over HTTP, on SQLite and on PostgreSQL: join, consent, judge, look, export."""

import csv
import io
import json

import pytest
from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens

from echoavatar.wire.codec import decode_server
from echoavatar_studio.making import Maker
from echoavatar_studio.wire import QUESTIONS


def test_a_pairwise_study_from_link_to_table(either: Maker, library):
    study, app = canned.make_pairwise(either, library, raters=2), app_of(either)
    for token in tokens(either, study, 2):
        rater = RaterPerson(app).begin(token)
        first = rater.task()
        assert (first["stage"], first["number"], len(first["clips"])) == ("training", 1, 2)
        lengths = {decode_server(rater.get(clip).content).frames for clip in first["clips"]}
        assert lengths == {30}
        sound = rater.get(first["audio"])
        assert sound.headers["content-type"] == "audio/flac"
        assert sound.content[:4] == b"fLaC"
        while (task := rater.task()) is not None:
            assert rater.answer(task).json()["is_repeated"] is False
        done = rater.get("/api/rater/me").json()["progress"]
        assert done == {"done": 9, "of": 9, "is_finished": True}  # 1 practice, 6 that count, 2 checks
    owner = OwnerPerson(app)
    assert owner.log_in().status_code == 200
    detail = owner.get(f"/api/owner/studies/{study}").json()
    assert detail["study"]["judgements"] == detail["study"]["judgements_wanted"] == 12
    assert {cell["category"]: cell["of"] for cell in detail["progress"]} == {"dance": 6, "gesture": 6}
    results = owner.get(f"/api/owner/studies/{study}/results").json()
    assert results["judgements"] == 12
    assert {row["system"] for row in results["rows"]} == set(canned.SYSTEMS)
    for name in (*results["exports"], *results["plots"]):
        answer = owner.get(f"/api/owner/studies/{study}/export/{name}")
        assert answer.status_code == 200, name
        assert answer.content
    rows = list(csv.DictReader(io.StringIO(owner.get(f"/api/owner/studies/{study}/export/judgements.csv").text)))
    assert len(rows) == 18
    # everybody said 2 for the clip on the right: towards the first system that is 2 where it was swapped, else -2
    assert {(row["is_swapped"], row["overall_preference"]) for row in rows} == {("1", "2"), ("0", "-2")}
    raters = owner.get(f"/api/owner/studies/{study}/raters").json()["raters"]
    assert [(row["done"], row["of"], row["straight"]) for row in raters] == [(9, 9, 1.0)] * 2
    actions = [event["action"] for event in owner.get(f"/api/owner/audit?study={study}").json()["events"]]
    assert actions.count("judged") == 18
    assert {"study begun", "study opened", "invited", "joined", "came", "consented", "exported"} & set(actions)


def test_a_preference_study_from_link_to_pairs(either: Maker):
    study, app = canned.make_preference(either), app_of(either)
    with either.store.read() as session:
        from echoavatar_studio.tables import Task

        order = {task.public: task.order for task in session.query(Task)}
    for token in tokens(either, study, 2):
        rater = RaterPerson(app).begin(token)
        while (task := rater.task()) is not None:
            slots = [order[task["id"]].index(place) for place in (2, 5)]  # candidate 3 is best, 6 worst
            assert rater.answer(task, best=slots[0], worst=slots[1]).status_code == 200
    owner = OwnerPerson(app)
    owner.log_in()
    results = owner.get(f"/api/owner/studies/{study}/results").json()
    told = [(row["chosen"], row["rejected"], row["agreement"], row["is_kept"]) for row in results["preferences"]]
    assert told == [(2, 5, 1.0, True)] * 3
    lines = owner.get(f"/api/owner/studies/{study}/export/pairs.jsonl").text.splitlines()
    pairs = [json.loads(line) for line in lines]
    assert [(pair["clip"], pair["start"], pair["past"], pair["margin"]) for pair in pairs] == [
        (f"clip{k}", 0, 1, 1.0) for k in range(3)
    ]
    assert pairs[0]["chosen"] == [[[2, 2]] * 3] * 4
    assert pairs[0]["rejected"] == [[[5, 5]] * 3] * 4
    assert pairs[0]["seeds"] == [1002, 1005]
    assert (pairs[0]["model"], pairs[0]["audio"]) == ("default", "sound 0")


def test_raters_are_told_nothing_of_the_design(maker: Maker, library):
    """No name of a system, no seed, no role and no name of a clip is in anything that a rater is sent."""
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker))
    rater.begin(tokens(maker, study, 1)[0])
    told = rater.get("/api/rater/me").text
    addresses: list[str] = []
    while (task := rater.task()) is not None:
        told += rater.get("/api/rater/task").text
        for address in (task["audio"], *task["clips"]):
            answer = rater.get(address)
            told += str(dict(answer.headers))
            addresses.append(address)
            assert answer.headers["last-modified"] == "Thu, 01 Jan 1970 00:00:00 GMT"
        told += rater.answer(task).text
    for secret in (*canned.SYSTEMS, "identical", "corrupted", "seed", ".motion", ".flac", study):
        assert secret not in told, secret
    assert len(set(addresses)) == len(addresses)  # the same clip has another address in another task


def test_questions_can_be_left_out(maker: Maker, library):
    study = canned.make_pairwise(maker, library, questions=["overall_preference"])
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    assert rater.get("/api/rater/me").json()["study"]["questions"] == ["overall_preference"]
    refused = rater.answer(rater.task())  # answers all three
    assert refused.json()["code"] == "bad_request"
    assert rater.answer(rater.task(), ratings={"overall_preference": -1}).status_code == 200
    assert len(QUESTIONS) == 3


@pytest.mark.parametrize("path", ["/api/nothing", "/api/rater", "/nowhere", "/assets/x.js"])
def test_unknown_addresses_are_problems_too(maker: Maker, path: str):
    answer = RaterPerson(app_of(maker)).get(path)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
