"""A mirror of the hub on this machine, honest or not: what it states and what it sends are set apart."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.http_server import Handler, HttpServer, running

COMMIT = "c0ffee" + "0" * 34


class Mirror(HttpServer):
    """`told` is the description of the one repository, `sent` the bytes by name.

    `by_name` holds another way to answer for a file: a function of the handler.
    """

    def __init__(self) -> None:
        super().__init__(self._answer)
        self.told: Any = {"id": "owner/name", "sha": COMMIT, "siblings": []}
        self.sent: dict[str, bytes] = {}
        self.by_name: dict[str, Any] = {}

    def add(self, name: str, data: bytes, *, is_large: bool = True, **stated: Any) -> None:
        """Add a file; `stated` overrides what is stated of it."""
        told: dict[str, Any] = {"rfilename": name, "size": len(data)}
        if is_large:
            told["lfs"] = {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data), "pointerSize": 130}
        else:
            told["blobId"] = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
        self.told["siblings"].append({**told, **stated})
        self.sent[name] = data

    def _answer(self, handler: Handler) -> None:
        if handler.path.startswith("/api/"):
            return handler.answer(200, self.told)
        name, start = handler.path.rpartition(f"/resolve/{COMMIT}/")[2], 0
        if name in self.by_name:
            self.by_name[name](handler)
            return None
        if name not in self.sent:
            return handler.answer(404)
        if "range" in handler.given:
            start = int(handler.given["range"].removeprefix("bytes=").removesuffix("-"))
        return handler.answer(206 if start else 200, self.sent[name][start:])

    def downloads(self) -> list[str]:
        return [path.partition(f"/resolve/{COMMIT}/")[2] for _, path, _ in self.asked if "/resolve/" in path]


@contextmanager
def hub_mirror() -> Iterator[Mirror]:
    with running(Mirror()) as mirror:
        yield mirror
