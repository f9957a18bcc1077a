"""Other ids, other studies, forged forms, oversized and malformed posts: refused, logged, others unharmed."""

import pytest
from starlette.applications import Starlette
from starlette.routing import Route
from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens, usual

from echoavatar.wire.rates import Rate
from echoavatar_studio.http import Rates
from echoavatar_studio.making import Maker
from echoavatar_studio.tables import Event, Judgement, Study


def actions(maker: Maker) -> list[str]:
    with maker.store.read() as session:
        return [event.action for event in session.query(Event).order_by(Event.id)]


@pytest.fixture
def scene(either: Maker, library):
    """A bad rater and a good one in one study, and a third in another. On SQLite and on PostgreSQL."""
    app = app_of(either)
    one, two = canned.make_pairwise(either, library), canned.make_preference(either)
    bad, good = (RaterPerson(app).begin(token) for token in tokens(either, one, 2))
    other = RaterPerson(app).begin(tokens(either, two, 1)[0])
    return either, bad, good, other


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
        "clips/" + "9" * 5_000,
        "clips/%00",
        "clips/-1",
        "clips/..%2f..%2fstudio.db",
        "clips/../audio/x",
    ):
        assert bad.get(f"/api/rater/tasks/{own['id']}/{path}").json()["code"] == "not_found"
    assert "refused: not_found" in actions(maker)


def every(app: Starlette, prefix: str, study: str) -> list[tuple[str, str]]:
    """Method and address of all routes below a prefix that ask for a session."""
    filled = {"{study}": study, "{number}": "1", "{name}": "results.json", "{task}": "none", "{slot}": "0"}
    found = []
    for route in app.routes:
        if isinstance(route, Route) and route.path.startswith(prefix) and not route.path.endswith(("join", "login")):
            path = route.path
            for name, value in filled.items():
                path = path.replace(name, value)
            found += [(method, path) for method in route.methods - {"HEAD"}]
    return found


@pytest.mark.parametrize("has_cookie", [False, True])
def test_no_route_of_owners_opens_to_a_rater(scene, has_cookie: bool):
    """Not even with the rater's own token under the name of the owners' cookie, which any browser lets one set."""
    maker, bad, _, _ = scene
    if has_cookie:
        bad.http.cookies.set("studio_owner", bad.http.cookies["studio_rater"], path="/api/owner")
    with maker.store.read() as session:
        study = session.query(Study).first().public
    routes = every(bad.http.app, "/api/owner", study)
    assert len(routes) == 17
    for method, path in routes:
        answer = bad.http.request(method, path, headers={"x-csrf-token": bad.csrf})
        assert (answer.status_code, answer.json()["code"]) == (401, "not_signed_in"), (method, path)
    with maker.store.read() as session:
        told = session.query(Event).filter(Event.action == "refused: not_signed_in").all()
    assert {event.actor for event in told} == {"rater 1" if has_cookie else "stranger"}
    assert len(told) == 16  # all but `me`, which pages ask before anybody signs in


def test_no_route_of_raters_opens_to_an_owner(scene):
    maker, bad, _, _ = scene
    owner = OwnerPerson(bad.http.app)
    owner.log_in()
    owner.http.cookies.set("studio_rater", owner.http.cookies["studio_owner"], path="/api/rater")
    routes = every(bad.http.app, "/api/rater", "")
    assert len(routes) == 8
    for method, path in routes:
        answer = owner.http.request(method, path, headers={"x-csrf-token": owner.csrf})
        assert (answer.status_code, answer.json()["code"]) == (401, "not_signed_in"), (method, path)


@pytest.mark.parametrize("prefix", ["/api/owner", "/api/rater"])
def test_no_change_passes_without_the_csrf_token_of_its_own_session(scene, prefix: str):
    """Every route that changes something, each without a token, with a wrong one and with another session's."""
    maker, bad, good, _ = scene
    owner = OwnerPerson(bad.http.app)
    owner.log_in()
    person = owner if prefix.endswith("owner") else bad
    with maker.store.read() as session:
        study = session.query(Study).first().public
    changes = [(method, path) for method, path in every(bad.http.app, prefix, study) if method != "GET"]
    assert len(changes) >= 4
    for method, path in changes:
        for token in ("", "x" * 43, good.csrf):
            answer = person.http.request(method, path, headers={"x-csrf-token": token})
            assert (answer.status_code, answer.json()["code"]) == (403, "bad_csrf"), (method, path)


@pytest.mark.parametrize("prefix", ["/api/owner", "/api/rater"])
def test_no_change_passes_from_a_page_of_another_address(maker: Maker, library, prefix: str):
    """Every route that changes something, signing in included, though cookie and CSRF token are right."""
    study = canned.make_pairwise(maker, library)
    owner = OwnerPerson(app_of(maker))
    owner.log_in()
    person = owner if prefix.endswith("owner") else RaterPerson(owner.http.app).begin(tokens(maker, study, 1)[0])
    changes = [(method, path) for method, path in every(owner.http.app, prefix, study) if method != "GET"]
    changes.append(("POST", f"{prefix}/{'login' if person is owner else 'join'}"))
    before = actions(maker)
    for method, path in changes:
        for origin in ("https://evil.example", "null", "http://studio.test.evil.example", "http://studio.test:81"):
            headers = {"x-csrf-token": person.csrf, "origin": origin, "content-type": "application/json"}
            answer = person.http.request(method, path, headers=headers, content=b"{}")
            assert (answer.status_code, answer.json()["code"]) == (403, "bad_origin"), (method, path, origin)
    assert set(actions(maker)[len(before) :]) == {"refused: bad_origin"}


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
    assert good.post(path, usual(task), idempotency_key="key-12345", origin="null").json()["code"] == "bad_origin"
    form = good.post(path, usual(task), idempotency_key="key-12345", content_type="text/plain")
    assert form.json()["code"] == "bad_request"
    own = good.post(path, usual(task), idempotency_key="key-12345", origin="http://studio.test")
    assert own.status_code == 200
    assert {"refused: bad_csrf", "refused: bad_origin", "refused: bad_request"} <= set(actions(maker))


MALFORMED = (
    b"", b"{", b"null", b"[]", b"\xff\xfe", b"[" * 60_000, b'{"type":"pairwise"}', b'{"type":"nothing"}',
    b'{"type":"skip","reason":"no_difference","seconds":1e999,"plays":[1,1]}',
    b'{"type":"skip","reason":"no_difference","seconds":1,"plays":[99999999999999999999999,1]}',
    b'{"type":"pairwise","ratings":{"human_likeness":true},"seconds":1,"plays":[1,1]}',
)  # fmt: skip


def test_malformed_posts_are_refused(scene):
    maker, bad, _, _ = scene
    task = bad.task()
    for body in MALFORMED:
        refused = bad.post(f"/api/rater/tasks/{task['id']}/answer", body, idempotency_key="key-12345")
        assert (refused.status_code, refused.json()["code"]) == (400, "bad_request"), body
    assert actions(maker).count("refused: bad_request") == len(MALFORMED)
    assert bad.answer(task).status_code == 200


NO_TEXT = (
    rb'{"X":"\ud800"}', rb'{"X":"a\udc00b"}', rb'{"X":"\ud83d\u0041"}', b'{"X":"\xed\xa0\x80"}', b'{"X":"\xff"}',
    rb'{"X":"\u0000"}', b'{"X":"a\0b"}', b'{"X":NaN}', b'{"X":Infinity}', b'{"X":-1e999}',
    b'{"X":' + b"9" * 5_000 + b"}", b'{"X":' + b"[" * 30_000,
    b'{"X":' + b'{"X":' * 5_000, b"\xef\xbb\xbf{}", b'{"\\ud800":1}',
)  # fmt: skip


TEXT_ROUTES = {
    "/api/owner/login": b"name", "/api/owner/login ": b"password", "/api/rater/join": b"token",
    "/api/owner/studies": b"settings", "/api/owner/studies/{}/invitations": b"label",
    "/api/owner/studies/{}/raters/1/exclude": b"reason",
}  # fmt: skip


def test_text_that_is_no_text_and_numbers_that_are_none_reach_no_route(maker: Maker, library):
    study = canned.make_pairwise(maker, library)
    owner = OwnerPerson(app_of(maker))
    owner.log_in()
    for path, field in TEXT_ROUTES.items():
        for body in NO_TEXT:
            answer = owner.post(path.strip().format(study), body.replace(b"X", field))
            assert (answer.status_code, answer.json()["code"]) == (400, "bad_request"), (path, body[:80])


def test_oversized_posts_are_refused_whether_they_say_so_or_not(scene):
    _, bad, _, _ = scene
    path = f"/api/rater/tasks/{bad.task()['id']}/answer"
    large = b" " * (1 << 16) + b"{}"
    assert bad.post(path, large, idempotency_key="key-12345").json()["code"] == "too_large"
    headers = {"x-csrf-token": bad.csrf, "content-type": "application/json", "idempotency-key": "key-12345"}
    stream = bad.http.post(path, content=(b" " * 1000 for _ in range(100)), headers=headers)
    assert stream.json()["code"] == "too_large"


def test_idempotency_keys_have_a_form(scene):
    _, bad, _, _ = scene
    for key in ("", "short", "x" * 65, "semi;colon!", "new\tline--"):
        assert bad.answer(bad.task(), key=key).json()["code"] == "bad_request", key


def test_floods_are_held_and_others_go_on(maker: Maker, library):
    study = canned.make_pairwise(maker, library)
    rates = Rates(*[Rate(5, 1)] * 6)
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


def test_a_stranger_who_guesses_does_not_lock_the_owner_out(maker: Maker):
    """Four guesses a second for a while from one address; the owner signs in from another at the first try."""
    app = app_of(maker, Rates())
    stranger, owner = OwnerPerson(app, "203.0.113.7"), OwnerPerson(app, "198.51.100.1")
    said = [stranger.log_in(password=f"guess {k}").json()["code"] for k in range(40)]
    assert said.count("bad_login") <= 9
    assert said[-1] == "too_many_requests"
    assert owner.log_in().status_code == 200


def test_guesses_from_many_addresses_share_the_limit_of_the_account(maker: Maker):
    app = app_of(maker, Rates(account=Rate(2, 1e-6)))
    said = [OwnerPerson(app, f"203.0.113.{k}").log_in(password="guess").json()["code"] for k in range(5)]
    assert said == ["bad_login", "bad_login", "too_many_requests", "too_many_requests", "too_many_requests"]


def test_a_known_owner_signs_in_while_the_account_is_under_attack(maker: Maker):
    app = app_of(maker, Rates(login=Rate(2, 1e-6), account=Rate(3, 1e-6)))
    assert OwnerPerson(app, "198.51.100.1").log_in().status_code == 200
    for k in range(9):
        OwnerPerson(app, f"203.0.113.{k}").log_in(password="guess")
    assert OwnerPerson(app, "203.0.113.99").log_in().status_code == 429
    assert OwnerPerson(app, "198.51.100.1").log_in().status_code == 200


def test_addresses_of_one_ipv6_network_share_a_limit(maker: Maker):
    app = app_of(maker, Rates(login=Rate(2, 1e-6)))
    said = [OwnerPerson(app, f"2001:db8::{k:x}").log_in(password="guess").json()["code"] for k in range(3)]
    assert said == ["bad_login", "bad_login", "too_many_requests"]


HOSTILE_SETTINGS = (
    f"seed: {'9' * 5_000}", "seed: 99999999999999999999", "title: 2024-13-45", "title: 2024-02-30 25:00:00",
    'title: "a\\0b"', 'sounds: [{path: "a\\0b", category: dance}]', "sounds: [{path: m, category: dance, start: .inf}]",
    "seed: 0x" + "f" * 5_000, f"seed: {'9' * 400}.0", "? [a, b]\n: c", "a: &a [*a]", "title: !!binary '***'",
)  # fmt: skip


@pytest.mark.parametrize("line", HOSTILE_SETTINGS, ids=range(len(HOSTILE_SETTINGS)))
def test_settings_that_cannot_be_are_refused(either: Maker, line: str):
    owner = OwnerPerson(app_of(either))
    owner.log_in()
    field = line.partition(":")[0]
    kept = [row for row in canned.pairwise_text().splitlines() if not row.startswith(f"{field}:")]
    if field == "sounds":
        kept = [row for row in kept if not row.startswith(("- category", "  path"))]
    answer = owner.post("/api/owner/studies", {"settings": "\n".join([*kept, line])})
    assert (answer.status_code, answer.json()["code"]) == (400, "bad_request")


def test_numbers_and_names_in_addresses_that_cannot_be_are_not_found(either: Maker, library):
    study = canned.make_pairwise(either, library)
    owner = OwnerPerson(app_of(either))
    owner.log_in()
    for number in ("9" * 5_000, "9" * 20, "%00", "-1", "1.5", "%D9%A3"):
        for path in (f"{study}/raters/{number}", f"{study}/invitations/{number}"):
            assert owner.delete(f"/api/owner/studies/{path}").json()["code"] == "not_found", path
    for name in ("%00", "a%00b", "..%2f..", "%ff%fe"):
        assert owner.get(f"/api/owner/studies/{name}").json()["code"] == "not_found", name
    assert owner.get("/api/owner/audit?study=%00").json()["code"] in ("bad_request", "not_found")
    assert owner.get("/api/owner/audit?before=" + "9" * 5_000).json()["code"] == "bad_request"


def test_text_with_nul_is_refused(either: Maker, library):
    study = canned.make_pairwise(either, library)
    owner = OwnerPerson(app_of(either))
    owner.log_in()
    answer = owner.post(f"/api/owner/studies/{study}/invitations", {"count": 1, "label": "a\0b"})
    assert (answer.status_code, answer.json()["code"]) == (400, "bad_request")
    assert owner.log_in(name="a\0b").json()["code"] == "bad_request"


def test_refusals_are_logged_but_cannot_fill_the_store(maker: Maker, monkeypatch):
    monkeypatch.setattr("echoavatar_studio.http._AUDIT_RATE", Rate(5, 1e-6))
    stranger = RaterPerson(app_of(maker))
    for _ in range(20):
        stranger.join("x" * 43)
    assert actions(maker).count("refused: bad_invitation") == 5


SCRIPT = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'"


def test_stored_scripts_leave_only_as_data(maker: Maker, library):
    """Answers are JSON that browsers may not guess about, exports are downloads, and pages allow no inline script."""
    study = canned.make_pairwise(maker, library, title=SCRIPT, intro=SCRIPT, consent=SCRIPT)
    owner, rater = OwnerPerson(app_of(maker)), RaterPerson(app_of(maker))
    owner.log_in()
    path = f"/api/owner/studies/{study}"
    owner.post(f"{path}/invitations", {"count": 1, "label": SCRIPT})
    answers = [rater.join(tokens(maker, study, 1)[0]), owner.post(f"{path}/raters/1/exclude", {"reason": SCRIPT})]
    answers += [owner.get(path + below) for below in ("", "/invitations", "/raters", "/results")]
    answers += [owner.get("/api/owner/studies"), owner.get("/api/owner/audit")]
    assert sum("script" in answer.text for answer in answers) >= 5
    for answer in answers:
        assert answer.headers["content-type"] == "application/json"
        assert answer.headers["x-content-type-options"] == "nosniff"
    found = answers[5].json()
    for name in (*found["exports"], *found["plots"]):
        answer = owner.get(f"{path}/export/{name}")
        assert answer.headers["content-disposition"].startswith("attachment")
        assert answer.headers["x-content-type-options"] == "nosniff"
    for page in ("/", "/rate"):
        policy = owner.get(page).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self' 'wasm-unsafe-eval';" in policy


def test_nothing_of_all_this_was_kept(scene):
    maker, bad, _, _ = scene
    bad.post("/api/rater/tasks/none/answer", usual(bad.task()), idempotency_key="key-12345")
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 0
