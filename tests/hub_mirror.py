"""A mirror of the hub on this machine, honest or not: what it states and what it sends are set apart."""

import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

COMMIT = "c0ffee" + "0" * 34


class Mirror(ThreadingHTTPServer):
    """`told` is the description of the one repository, `sent` the bytes by name; `asked` records method, path, headers.

    `by_name` holds another way to answer for a file: a function of the handler.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.told: Any = {"id": "owner/name", "sha": COMMIT, "siblings": []}
        self.sent: dict[str, bytes] = {}
        self.by_name: dict[str, Any] = {}
        self.asked: list[tuple[str, str, dict[str, str]]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def add(self, name: str, data: bytes, *, is_large: bool = True, **stated: Any) -> None:
        """Add a file; `stated` overrides what is stated of it."""
        told: dict[str, Any] = {"rfilename": name, "size": len(data)}
        if is_large:
            told["lfs"] = {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data), "pointerSize": 130}
        else:
            told["blobId"] = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
        self.told["siblings"].append({**told, **stated})
        self.sent[name] = data

    def downloads(self) -> list[str]:
        return [path.partition(f"/resolve/{COMMIT}/")[2] for _, path, _ in self.asked if "/resolve/" in path]


class _Handler(BaseHTTPRequestHandler):
    server: Mirror

    def do_GET(self) -> None:
        self.server.asked.append((self.command, self.path, {k.lower(): v for k, v in self.headers.items()}))
        if self.path.startswith("/api/"):
            told = self.server.told
            return self.answer(200, told if isinstance(told, bytes) else json.dumps(told).encode())
        name = self.path.rpartition(f"/resolve/{COMMIT}/")[2]
        if name in self.server.by_name:
            self.server.by_name[name](self)
            return None
        if name not in self.server.sent:
            return self.answer(404, b"")
        data, start = self.server.sent[name], 0
        if "range" in self.headers:
            start = int(self.headers["range"].removeprefix("bytes=").removesuffix("-"))
        return self.answer(206 if start else 200, data[start:])

    def answer(self, status: int, body: bytes, **headers: str) -> None:
        self.send_response(status)
        for name, value in {"content-length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None: ...


@contextmanager
def hub_mirror() -> Iterator[Mirror]:
    mirror = Mirror()
    thread = threading.Thread(target=mirror.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield mirror
    finally:
        mirror.shutdown()
        mirror.server_close()
        thread.join()
