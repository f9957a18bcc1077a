"""Invitations, consent, places, and being forgotten. On SQLite and on PostgreSQL."""

from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens

from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.tables import Block, Judgement, Rater


def test_consent_comes_before_everything(either: Maker, library):
    study = canned.make_pairwise(either, library)
    rater = RaterPerson(app_of(either))
    token = tokens(either, study, 1)[0]
    joined = rater.join(token).json()
    assert (joined["has_consented"], joined["progress"]["of"], joined["resume"]) == (False, 0, "")
    assert rater.get("/api/rater/task").json()["code"] == "needs_consent"
    declined = rater.post("/api/rater/consent", {"agreed": False})
    assert declined.json()["code"] == "not_signed_in"
    assert rater.get("/api/rater/me").status_code == 401
    with either.store.read() as session:
        assert session.query(Rater).count() == 0


def test_an_open_link_takes_so_many_and_gives_each_a_link_of_their_own(either: Maker, library):
    study, app = canned.make_pairwise(either, library), app_of(either)
    token = tokens(either, study, 2, is_open=True)[0]
    one, two, three = (RaterPerson(app) for _ in range(3))
    resume = one.join(token).json()["resume"]
    assert resume.startswith("http://studio.test/rate#")
    again = one.join(token).json()  # a reload of the link: the same rater
    assert again["resume"] == ""
    two.join(token)
    full = three.join(token)
    assert (full.status_code, full.json()["code"]) == (409, "study_full")
    elsewhere = RaterPerson(app)
    assert elsewhere.join(resume.split("#")[1]).status_code == 200
    with either.store.read() as session:
        assert session.query(Rater).count() == 2


def test_places_end_with_the_blocks(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library, raters=1), app_of(maker)
    first, second = tokens(maker, study, 2)
    RaterPerson(app).begin(first)
    late = RaterPerson(app)
    late.join(second)
    assert late.post("/api/rater/consent", {"agreed": True}).json()["code"] == "study_full"


def test_links_that_are_wrong_revoked_or_closed(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    rater = RaterPerson(app)
    assert rater.join("x" * 43).json()["code"] == "bad_invitation"
    assert rater.join("short").json()["code"] == "bad_request"
    token = tokens(maker, study, 1)[0]
    actions = OwnerActions(maker, "test")
    actions.revoke(study, actions.invitations(study).invitations[0].id)
    assert rater.join(token).json()["code"] == "bad_invitation"
    token = tokens(maker, study, 1)[0]
    actions.change_state(study, "closed")
    assert rater.join(token).json()["code"] == "study_closed"


def test_a_closed_study_takes_no_answers_but_knows_those_it_has(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    rater = RaterPerson(app).begin(tokens(maker, study, 1)[0])
    task = rater.task()
    rater.answer(task, key="before-closing")
    following = rater.task()
    OwnerActions(maker, "test").change_state(study, "closed")
    assert rater.answer(task, key="before-closing").json()["is_repeated"] is True
    assert rater.answer(following).json()["code"] == "study_closed"
    assert rater.get("/api/rater/task").json()["code"] == "study_closed"


def test_withdrawing_deletes_everything_and_frees_the_place(either: Maker, library):
    study, app = canned.make_pairwise(either, library, raters=1), app_of(either)
    one, two = tokens(either, study, 2)
    rater = RaterPerson(app).begin(one)
    rater.answer(rater.task())
    assert rater.post("/api/rater/withdraw", {"sure": False}).json()["code"] == "bad_request"
    assert rater.post("/api/rater/withdraw", {"sure": True}).json() == {"ok": True}
    assert rater.get("/api/rater/me").json()["code"] == "not_signed_in"
    assert rater.join(one).json()["code"] == "bad_invitation"
    with either.store.read() as session:
        assert session.query(Rater).count() == session.query(Judgement).count() == 0
        assert session.query(Block).one().rater_id is None
    RaterPerson(app).begin(two)
    owner = OwnerPerson(app)
    owner.log_in()
    events = owner.get(f"/api/owner/audit?study={study}").json()["events"]
    assert [event["detail"] for event in events if event["action"] == "rater deleted"] == ["rater 1: withdrew"]


def test_leaving_ends_the_session_and_the_link_opens_it_again(maker: Maker, library):
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    token = tokens(maker, study, 1)[0]
    rater = RaterPerson(app).begin(token)
    rater.post("/api/rater/leave")
    assert rater.get("/api/rater/me").status_code == 401
    assert rater.join(token).json()["has_consented"] is True
