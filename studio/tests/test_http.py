"""The way in: sessions, limits and mistakes of our own."""

import msgspec
from starlette.applications import Starlette
from starlette.responses import Response
from studio.tests import canned
from studio.tests.people import Person

from echoavatar.wire.rates import Rate
from echoavatar_studio.http import Call, Gate, Rates, decoded
from echoavatar_studio.making import Maker
from echoavatar_studio.wire_rater import Consent, Done


def person(maker: Maker, work, *, rates: Rates = canned.EASY, method: str = "GET") -> Person:
    gate = Gate(maker.store, rates=rates, origins=("https://studio.example.org",))
    return Person(Starlette(routes=[gate.route(method, "/x", work, who="rater", signed=False)]))


def test_replies_are_not_stored_by_browsers(maker: Maker):
    answer = person(maker, lambda call: Done()).get("/x")
    assert answer.json() == {"ok": True}
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_mistakes_of_the_studio_tell_nothing_and_are_logged(maker: Maker, caplog):
    def broken(call: Call) -> Response:
        raise RuntimeError("a secret of ours")

    answer = person(maker, broken).get("/x")
    assert (answer.status_code, answer.json()["code"]) == (500, "internal")
    assert "secret" not in answer.text
    assert "a secret of ours" in caplog.text


def test_strangers_have_a_rate(maker: Maker):
    visitor = person(maker, lambda call: Done(), rates=Rates(stranger=Rate(2, 1e-6)))
    assert [visitor.get("/x").status_code for _ in range(3)] == [200, 200, 429]


def test_pages_behind_a_proxy_are_let_in_by_name(maker: Maker):
    visitor = person(maker, lambda call: Done(), method="POST")
    assert visitor.post("/x", {}, origin="https://studio.example.org").status_code == 200
    assert visitor.post("/x", {}, origin="https://studio.example.com").json()["code"] == "bad_origin"
    assert visitor.post("/x", {}, origin="http://[").json()["code"] == "bad_origin"


def test_messages_are_decoded_strictly(maker: Maker):
    visitor = person(maker, lambda call: Done(ok=decoded(call, Consent).agreed), method="POST")
    assert visitor.post("/x", {"agreed": True}).json() == {"ok": True}
    for body in ({"agreed": "yes"}, {}, {"agreed": True, "more": 1}):
        assert visitor.post("/x", body).json()["code"] == "bad_request"
    assert msgspec.json.decode(b"{}") == {}
