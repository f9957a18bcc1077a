"""Signing in, and what is exported."""

import pytest
from studio.tests import canned
from studio.tests.people import OwnerPerson, app_of

from echoavatar_studio.making import Maker


@pytest.fixture
def owner(maker: Maker) -> OwnerPerson:
    person = OwnerPerson(app_of(maker))
    person.log_in()
    return person


def test_signing_in_and_out(maker: Maker):
    owner = OwnerPerson(app_of(maker))
    assert owner.get("/api/owner/studies").json()["code"] == "not_signed_in"
    assert owner.log_in(password="wrong password").json()["code"] == "bad_login"
    answer = owner.log_in()
    assert "Path=/api/owner" in answer.headers["set-cookie"]
    assert owner.get("/api/owner/me").json() == {"name": "anna", "csrf": owner.csrf}
    assert owner.post("/api/owner/logout").json() == {"ok": True}
    assert owner.get("/api/owner/me").status_code == 401


def test_changes_want_the_csrf_token(maker: Maker, library, owner: OwnerPerson):
    study = canned.make_pairwise(maker, library)
    owner.csrf = "forged"
    assert owner.delete(f"/api/owner/studies/{study}").json()["code"] == "bad_csrf"
    assert owner.post(f"/api/owner/studies/{study}/state", {"state": "closed"}).json()["code"] == "bad_csrf"


def test_files_of_the_other_kind_and_unknown_ones_do_not_exist(maker: Maker, library, owner: OwnerPerson):
    pairwise, preference = canned.make_pairwise(maker, library), canned.make_preference(maker)
    for study, name in ((pairwise, "pairs.jsonl"), (preference, "table.tex"), (pairwise, "..%2fstudio.db")):
        assert owner.get(f"/api/owner/studies/{study}/export/{name}").json()["code"] == "not_found", name
    got = owner.get(f"/api/owner/studies/{preference}/export/pairs.jsonl")
    assert got.headers["content-disposition"] == 'attachment; filename="pairs.jsonl"'
    told = owner.get("/api/owner/audit").json()["events"]
    assert [event["detail"] for event in told if event["action"] == "exported"] == ["pairs.jsonl"]


@pytest.mark.parametrize("before", ["x", "-1", "9" * 40])
def test_the_audit_goes_on_from_a_line(owner: OwnerPerson, before: str):
    assert owner.get(f"/api/owner/audit?before={before}").json()["code"] == "bad_request"
    assert owner.get("/api/owner/audit?before=1").json()["events"] == []
