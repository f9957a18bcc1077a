"""Starting: folders, ports, and a real server that answers."""

import json
import resource
import socket
import threading
import urllib.request

import pytest
from studio.tests import canned

from echoavatar.errors import EchoAvatarError
from echoavatar_studio.run import _listen, allow_open_files, open_store


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(EchoAvatarError, match="cannot write"):
        open_store(tmp_path / "file", None)


def test_a_taken_port_is_told():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(EchoAvatarError, match="choose another --host or --port"):
            _listen("127.0.0.1", taken.getsockname()[1])


def test_connections_are_not_held_back_by_the_usual_limit_of_open_files():
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (1000, hard))
    allow_open_files()
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (hard, hard)


def test_the_studio_answers_over_a_socket(maker, monkeypatch):
    """uvicorn itself, in a thread: signals are the main thread's, so it is told to stop."""
    from echoavatar_studio import run
    from echoavatar_studio.app import create_app

    monkeypatch.setattr(run._Server, "capture_signals", lambda self: __import__("contextlib").nullcontext())
    servers, address, ready = [], [], threading.Event()
    begun = run._Server.__init__

    def kept(self, *args, **kwargs):
        begun(self, *args, **kwargs)
        servers.append(self)

    monkeypatch.setattr(run._Server, "__init__", kept)

    def told(where: str) -> None:
        address.append(where)
        ready.set()

    app = create_app(maker, rates=canned.EASY)
    thread = threading.Thread(target=run.serve, args=(app,), kwargs={"host": "127.0.0.1", "port": 0, "on_ready": told})
    thread.start()
    try:
        assert ready.wait(30)
        with urllib.request.urlopen(f"{address[0]}/api/scene", timeout=30) as answer:
            assert json.load(answer)["frame_rate"] == 30
    finally:
        servers[0].should_exit = True
        thread.join(30)
    assert not thread.is_alive()
