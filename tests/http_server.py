"""A web server on this machine: it notes what it is asked, and a function of the handler answers."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeVar

Act = Callable[["Handler"], Any]


class HttpServer(ThreadingHTTPServer):
    """`asked` holds the method, path and headers of each request; names of headers are in small letters."""

    daemon_threads = True

    def __init__(self, act: Act) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.act = act
        self.asked: list[tuple[str, str, dict[str, str]]] = []

    def handle_error(self, *_: object) -> None: ...  # clients hang up here

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: HttpServer
    protocol_version = "HTTP/1.1"  # WebSockets know no other

    def do_GET(self) -> None:
        self.given = {name.lower(): value for name, value in self.headers.items()}
        self.server.asked.append((self.command, self.path, self.given))
        self.body = self.rfile.read(int(self.given.get("content-length", 0)))
        self.server.act(self)

    do_POST = do_PATCH = do_CONNECT = do_GET  # noqa: N815

    def answer(self, status: int, told: object = b"", **headers: str) -> None:
        """Send bytes, or anything else as JSON."""
        body = told if isinstance(told, bytes) else json.dumps(told).encode()
        self.send_response(status)
        for name, value in {"content-length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None: ...


ServerT = TypeVar("ServerT", bound=HttpServer)


@contextmanager
def running(server: ServerT) -> Iterator[ServerT]:
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
