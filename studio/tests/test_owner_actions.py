"""Owners and their studies, over HTTP."""

import time

import pytest
from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens

from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.tables import Judgement, Study


@pytest.fixture
def owner(maker: Maker) -> OwnerPerson:
    person = OwnerPerson(app_of(maker))
    person.log_in()
    return person


def test_live_progress_counts_what_counts(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(owner.http.app).begin(tokens(maker, study, 1)[0])
    while (task := rater.task()) is not None:
        rater.answer(task)
    row = owner.get("/api/owner/studies").json()["studies"][0]
    assert (row["raters"], row["raters_wanted"], row["judgements"], row["judgements_wanted"]) == (1, 6, 6, 36)
    detail = owner.get(f"/api/owner/studies/{study}").json()
    assert sum(detail["per_hour"]) == 9
    assert detail["per_hour"][-1] >= 8
    assert sum(system["judgements"] for system in detail["systems"]) == 2 * 6  # two systems in each
    assert sum(cell["done"] for cell in detail["progress"]) == 6


@pytest.mark.parametrize("jump_s", [-3_600, -90_000, 3_600, 90_000])
def test_a_clock_that_was_set_breaks_no_page(maker: Maker, library, owner: OwnerPerson, monkeypatch, jump_s: int):
    """Answers of the future or of yesterday; signed-in raters go on, and a short jump signs no owner out."""
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(owner.http.app).begin(tokens(maker, study, 1)[0])
    rater.answer(rater.task())
    now = time.time()
    monkeypatch.setattr("time.time", lambda: now + jump_s)
    assert rater.answer(rater.task()).status_code == 200
    if jump_s > 43_200:
        assert owner.get("/api/owner/me").status_code == 401
        owner.log_in()
    assert sum(owner.get(f"/api/owner/studies/{study}").json()["per_hour"]) == (1 if jump_s == 90_000 else 2)
    for what in ("raters", "results", "invitations"):
        assert owner.get(f"/api/owner/studies/{study}/{what}").status_code == 200


def test_links_are_told_once_and_revoked(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    path = f"/api/owner/studies/{study}/invitations"
    links = owner.post(path, {"count": 3, "label": "class"}).json()["links"]
    assert len({link["url"] for link in links}) == 3
    assert links[0]["url"].startswith("http://studio.test/rate#")
    listed = owner.get(path)
    assert [row["label"] for row in listed.json()["invitations"]] == ["class"] * 3
    assert links[0]["url"].split("#")[1] not in listed.text
    assert owner.delete(f"{path}/{links[0]['id']}").json() == {"ok": True}
    assert owner.get(path).json()["invitations"][0]["is_revoked"] is True
    assert owner.post(path, {"count": 0}).json()["code"] == "bad_request"
    other = canned.make_pairwise(maker, library)
    assert owner.delete(f"/api/owner/studies/{other}/invitations/{links[1]['id']}").json()["code"] == "not_found"


def wanted(owner: OwnerPerson) -> int:
    return int(owner.get("/api/owner/studies").json()["studies"][0]["raters_wanted"])


def test_leaving_out_twice_gives_out_once_and_taking_in_takes_it_back(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    one, two = tokens(maker, study, 2)
    RaterPerson(owner.http.app).begin(one)
    path = f"/api/owner/studies/{study}/raters/1/exclude"
    for is_excluded, places in ((True, 7), (True, 7), (False, 6), (True, 7)):
        owner.post(path, {"is_excluded": is_excluded, "reason": "late"})
        assert wanted(owner) == places
    RaterPerson(owner.http.app).begin(two)  # has the second block, the copy is free
    owner.post(path, {"is_excluded": False})
    assert wanted(owner) == 6


def test_raters_are_excluded_and_deleted(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    token = tokens(maker, study, 1)[0]
    rater = RaterPerson(owner.http.app).begin(token)
    rater.answer(rater.task())
    path = f"/api/owner/studies/{study}/raters"
    assert owner.post(f"{path}/1/exclude", {"is_excluded": True, "reason": "too fast"}).json() == {"ok": True}
    assert owner.get(path).json()["raters"][0]["reason"] == "too fast"
    assert wanted(owner) == 7
    assert owner.delete(f"{path}/1").json() == {"ok": True}
    assert wanted(owner) == 6  # what was given out once more is in place of what was deleted
    assert owner.get(path).json()["raters"] == []
    assert rater.get("/api/rater/me").json()["code"] == "not_signed_in"
    assert owner.delete(f"{path}/1").json()["code"] == "not_found"
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 0


def test_studies_are_deleted_when_closed_with_their_files(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    path = f"/api/owner/studies/{study}"
    assert owner.delete(path).json()["code"] == "busy"
    assert owner.post(f"{path}/state", {"state": "closed"}).json()["state"] == "closed"
    assert owner.post(f"{path}/state", {"state": "making"}).json()["code"] == "bad_request"
    assert owner.delete(path).json() == {"ok": True}
    assert owner.get(path).json()["code"] == "not_found"
    assert not (maker.media / study).exists()
    told = [event["action"] for event in owner.get(f"/api/owner/audit?study={study}").json()["events"]]
    assert told[:2] == ["study deleted", "study closed"]  # the audit outlives it


def test_a_study_is_set_up_in_the_page(maker: Maker, owner: OwnerPerson):
    canned.library(maker.media.parent / "library", sounds=2)
    offered = owner.get("/api/owner/setup").json()
    assert "default" in offered["models"]
    assert set(canned.SYSTEMS) <= set(offered["folders"])
    assert {"music", "speech"} <= set(offered["sounds"])
    begun = owner.post("/api/owner/studies", {"settings": canned.pairwise_text()})
    assert begun.json()["state"] == "making"
    study = begun.json()["id"]
    for _ in range(300):
        row = owner.get(f"/api/owner/studies/{study}").json()["study"]
        if row["state"] != "making":
            break
        time.sleep(0.1)
    assert (row["state"], row["judgements_wanted"], row["making"]) == ("open", 36, None)


@pytest.mark.parametrize("path", ["../secret", "/etc", "music/../../.."])
def test_pages_reach_no_files_outside_the_library(maker: Maker, owner: OwnerPerson, path: str):
    text = canned.pairwise_text(sounds=[{"path": path, "category": "dance"}])
    refused = owner.post("/api/owner/studies", {"settings": text}).json()
    assert refused["code"] == "bad_request"
    assert "library" in refused["message"]
    text = canned.preference_text(model=path)
    assert owner.post("/api/owner/studies", {"settings": text}).json()["code"] == "bad_request"
    with maker.store.read() as session:
        assert session.query(Study).count() == 0


def test_a_delete_removes_nothing_outside_the_studys_own_folder(maker: Maker, library, owner: OwnerPerson):
    """The name of a study is made by us; in a store that was forged it may be a way up."""
    study = canned.make_pairwise(maker, library)
    kept = maker.media.parent / "kept"
    kept.write_text("")
    with maker.store.write() as session:
        session.query(Study).filter(Study.public == study).update({"public": "..", "state": "closed"})
    OwnerActions(maker, "test").delete("..")
    assert kept.exists()
    assert (maker.media / study).exists()
