"""Other ids, other studies, forged forms, oversized and malformed posts: refused, logged, others unharmed."""

import pytest
from tests.studio import canned
from tests.studio.people import OwnerPerson, RaterPerson, app_of, tokens, usual

from echoavatar.studio.limits import Rate, Rates
from echoavatar.studio.making import Maker
from echoavatar.studio.tables import Event, Judgement


def actions(maker: Maker) -> list[str]:
    with maker.store.read() as session:
        return [event.action for event in session.query(Event).order_by(Event.id)]


@pytest.fixture
def scene(maker: Maker, library):
    """A bad rater and a good one in one study, and a third in another."""
    app = app_of(maker)
    one, two = canned.make_pairwise(maker, library), canned.make_preference(maker)
    bad, good = (RaterPerson(app).begin(token) for token in tokens(maker, one, 2))
    other = RaterPerson(app).begin(tokens(maker, two, 1)[0])
    return maker, bad, good, other


def test_tasks_of_others_do_not_exist(scene):
    maker, bad, good, other = scene
    for victim in (good, other):
        task = victim.task()
        for address in (task["audio"], *task["clips"]):
            assert bad.get(address).json()["code"] == "not_found"
        forged = bad.post(f"/api/rater/tasks/{task['id']}/answer", usual(task), idempotency_key="forged-1")
        assert forged.json()["code"] == "not_found"
        assert victim.task() == task
        assert victim.answer(task).status_code == 200
    own = bad.task()
    for path in (
        "clips/2",
        "clips/99999999999999999999",
        "clips/-1",
        "clips/..%2f..%2fstudio.db",
        "clips/../audio/x",
    ):
        assert bad.get(f"/api/rater/tasks/{own['id']}/{path}").json()["code"] == "not_found"
    assert "refused: not_found" in actions(maker)


def test_a_rater_is_no_owner(scene, maker: Maker):
    _, bad, _, _ = scene
    for path in ("studies", "me", "audit", "setup"):
        assert bad.get(f"/api/owner/{path}").json()["code"] == "not_signed_in"
    bad.http.cookies.set("studio_owner", bad.http.cookies["studio_rater"], path="/api/owner")
    assert (
        bad.get("/api/owner/me").json()["code"] == "internal" or bad.get("/api/owner/me").status_code == 401
    )


def test_forged_forms_are_refused(scene):
    maker, bad, good, _ = scene
    task = good.task()
    path = f"/api/rater/tasks/{task['id']}/answer"
    csrf, good.csrf = good.csrf, ""
    assert good.post(path, usual(task), idempotency_key="key-12345").json()["code"] == "bad_csrf"
    good.csrf = bad.csrf
    assert good.post(path, usual(task), idempotency_key="key-12345").json()["code"] == "bad_csrf"
    good.csrf = csrf
    foreign = good.post(path, usual(task), idempotency_key="key-12345", origin="https://evil.example")
    assert foreign.json()["code"] == "bad_origin"
    assert (
        good.post(path, usual(task), idempotency_key="key-12345", origin="null").json()["code"]
        == "bad_origin"
    )
    form = good.post(path, usual(task), idempotency_key="key-12345", content_type="text/plain")
    assert form.json()["code"] == "bad_request"
    own = good.post(path, usual(task), idempotency_key="key-12345", origin="http://studio.test")
    assert own.status_code == 200
    assert {"refused: bad_csrf", "refused: bad_origin", "refused: bad_request"} <= set(actions(maker))


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"null", b"[]", b"\xff\xfe", b"[" * 60_000, b'{"type":"pairwise"}', b'{"type":"nothing"}',
        b'{"type":"skip","reason":"no_difference","seconds":1e999,"plays":[1,1]}',
        b'{"type":"skip","reason":"no_difference","seconds":1,"plays":[99999999999999999999999,1]}',
        b'{"type":"pairwise","ratings":{"human_likeness":true},"seconds":1,"plays":[1,1]}',
    ],
)  # fmt: skip
def test_malformed_posts_are_refused(scene, body: bytes):
    _, bad, _, _ = scene
    task = bad.task()
    refused = bad.post(f"/api/rater/tasks/{task['id']}/answer", body, idempotency_key="key-12345")
    assert (refused.status_code, refused.json()["code"]) == (400, "bad_request")
    assert bad.answer(task).status_code == 200


def test_oversized_posts_are_refused_whether_they_say_so_or_not(scene):
    _, bad, _, _ = scene
    path = f"/api/rater/tasks/{bad.task()['id']}/answer"
    large = b" " * (1 << 16) + b"{}"
    assert bad.post(path, large, idempotency_key="key-12345").json()["code"] == "too_large"
    headers = {"x-csrf-token": bad.csrf, "content-type": "application/json", "idempotency-key": "key-12345"}
    stream = bad.http.post(path, content=(b" " * 1000 for _ in range(100)), headers=headers)
    assert stream.json()["code"] == "too_large"


@pytest.mark.parametrize("key", ["", "short", "x" * 65, "semi;colon!", "new\tline--"])
def test_idempotency_keys_have_a_form(scene, key: str):
    _, bad, _, _ = scene
    assert bad.answer(bad.task(), key=key).json()["code"] == "bad_request"


def test_floods_are_held_and_others_go_on(maker: Maker, library):
    study = canned.make_pairwise(maker, library)
    rates = Rates(*[Rate(5, 1)] * 5)
    app = app_of(maker, rates)
    bad, good = RaterPerson(app), RaterPerson(app)
    one, two = tokens(maker, study, 2)
    good.begin(one)
    said = [bad.join("x" * 43).json()["code"] for _ in range(10)]
    assert said[0] == "bad_invitation"
    assert said[-1] == "too_many_requests"
    held = bad.join(two)
    assert held.status_code == 429
    assert int(held.headers["retry-after"]) >= 1
    assert good.task() is not None


def test_passwords_are_not_guessed_in_bulk(maker: Maker):
    app = app_of(maker, Rates(login=Rate(2, 1)))
    owner = OwnerPerson(app)
    said = [owner.log_in(password=f"guess {k}").json()["code"] for k in range(4)]
    assert said == ["bad_login", "bad_login", "too_many_requests", "too_many_requests"]
    assert owner.log_in().status_code == 429


def test_refusals_are_logged_but_cannot_fill_the_store(maker: Maker, monkeypatch):
    monkeypatch.setattr("echoavatar.studio.http._AUDIT_RATE", Rate(5, 1e-6))
    stranger = RaterPerson(app_of(maker))
    for _ in range(20):
        stranger.join("x" * 43)
    assert actions(maker).count("refused: bad_invitation") == 5


def test_nothing_of_all_this_was_kept(scene):
    maker, bad, good, _ = scene
    bad.post("/api/rater/tasks/none/answer", usual(bad.task()), idempotency_key="key-12345")
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 0
