"""Raters and owners as a browser would be: cookies, CSRF tokens, JSON."""

import itertools
import json
from typing import Any

from starlette.applications import Starlette
from starlette.testclient import TestClient
from studio.tests import canned

from echoavatar_studio.app import create_app
from echoavatar_studio.http import Rates
from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.wire_owner import Invite

_KEYS = itertools.count()


def app_of(maker: Maker, rates: Rates = canned.EASY) -> Starlette:
    return create_app(maker, rates=rates)


class Person:
    """A browser with a session of its own."""

    def __init__(self, app: Starlette, address: str = "testclient") -> None:
        self.http = TestClient(app, base_url="http://studio.test", client=(address, 50_000))
        self.csrf = ""

    def get(self, path: str) -> Any:
        return self.http.get(path)

    def post(self, path: str, body: object = None, **headers: str) -> Any:
        content = b"" if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        own = {"x-csrf-token": self.csrf, "content-type": "application/json"} | named
        return self.http.post(path, content=content, headers=own)

    def delete(self, path: str) -> Any:
        return self.http.delete(path, headers={"x-csrf-token": self.csrf})


class RaterPerson(Person):
    """Somebody with a link."""

    def join(self, token: str) -> Any:
        answer = self.post("/api/rater/join", {"token": token})
        if answer.status_code == 200:
            self.csrf = answer.json()["csrf"]
        return answer

    def begin(self, token: str) -> "RaterPerson":
        assert self.join(token).status_code == 200
        assert self.post("/api/rater/consent", {"agreed": True}).status_code == 200
        return self

    def task(self) -> Any:
        answer = self.get("/api/rater/task")
        assert answer.status_code == 200, answer.text
        return answer.json()["task"]

    def answer(self, task: Any, key: str | None = None, **changes: object) -> Any:
        body = usual(task) | changes
        key = f"key-{next(_KEYS):08d}" if key is None else key
        return self.post(f"/api/rater/tasks/{task['id']}/answer", body, idempotency_key=key)


class OwnerPerson(Person):
    """Anna."""

    def log_in(self, name: str = "anna", password: str = canned.PASSWORD) -> Any:
        answer = self.post("/api/owner/login", {"name": name, "password": password})
        if answer.status_code == 200:
            self.csrf = answer.json()["csrf"]
        return answer


def usual(task: Any) -> dict[str, Any]:
    """An answer that fits the task."""
    plays, seconds = [1] * len(task["clips"]), 3.0
    if len(task["clips"]) == 2:
        ratings = {"human_likeness": 1, "beat_matching": 0, "overall_preference": 2}
        return {"type": "pairwise", "ratings": ratings, "seconds": seconds, "plays": plays}
    return {"type": "preference", "best": 0, "worst": 1, "seconds": seconds, "plays": plays}


def tokens(maker: Maker, study: str, count: int, *, is_open: bool = False) -> list[str]:
    """Of new invitations."""
    links = OwnerActions(maker, "test").invite(study, Invite(count=count, is_open=is_open), page="").links
    return [link.url[1:] for link in links]
