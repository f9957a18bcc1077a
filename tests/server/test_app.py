"""What operators and agents ask for, over HTTP."""

import dataclasses
import http.client
import itertools
import logging
import socket
from collections.abc import Iterator

import pytest
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar import __version__
from echoavatar.wire.messages import Hello, Motion, Ping

SECRET = {"authorization": "Bearer secret"}


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving(seats=2, settings=dataclasses.replace(FAST, token="secret", connections=3)) as server:
        yield server


def test_health_is_open_and_says_what_is_free(server: RunningServer) -> None:
    status, facts = server.http("/health")
    assert status == 200
    assert facts == {"status": "ready", "version": __version__, "sessions": 0, "seats": 2, "free": 2}


def test_tools_and_metrics_ask_for_the_token(server: RunningServer) -> None:
    for path in ("/v1/tools", "/metrics"):
        assert server.http(path)[0] == 401
        assert server.http(path, authorization="Bearer wrong")[0] == 401
        assert server.http(path, **SECRET)[0] == 200
    tools = server.http("/v1/tools?style=openai", **SECRET)[1]
    assert [tool["type"] for tool in tools] == ["function"] * 4
    assert tools[0]["parameters"]["properties"]["action"]["enum"] == ["wave", "bow"]
    assert server.http("/v1/tools?style=unknown", **SECRET)[0] == 400


def test_metrics_count_what_happens(server: RunningServer) -> None:
    with server.call(Hello(token="secret")) as caller:
        caller.until(Motion)
        text = server.http("/metrics", **SECRET)[1]
    assert "echoavatar_sessions 1.0" in text
    assert 'echoavatar_messages_total{direction="in",type="hello"} 1.0' in text
    assert "echoavatar_chunk_seconds_count" in text


def test_a_wrong_token_is_refused_in_words(server: RunningServer) -> None:
    with server.call() as caller:
        caller.say(Hello(token="guess"))
        code, error = caller.closing()
    assert code == 4401
    assert error is not None
    assert "wrong token" in error.message


def test_no_log_answer_or_metric_shows_a_token(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """The server's own or one that somebody tries, wherever a client may put it, with every log switched on."""
    tokens, answers = ("own-very-secret", "tried-very-secret"), []
    with caplog.at_level(logging.DEBUG), serving(settings=dataclasses.replace(FAST, token=tokens[0])) as server:
        for token, path in itertools.product(tokens, ("/v1/tools", "/v1/tools/dance", "/metrics", "/v1/chat", "/no")):
            body = b"{" if path.endswith("dance") else None
            answers.append(server.http(path, body, authorization=f"Bearer {token}"))
            answers.append(server.http(f"{path}?token={token}", body))
        for token in tokens:
            with server.call(Hello(token=token) if token == tokens[0] else None) as caller:
                caller.say(Hello(token=token))  # the first is a fault now, the second a guess
                answers.append(caller.closing())
            with server.call(additional_headers={"authorization": f"Bearer {token}"}) as caller:
                caller.say(Ping())
                answers.append(caller.closing())
        answers.append(server.http("/metrics", authorization=f"Bearer {tokens[0]}"))
    shown = capfd.readouterr()
    ours = [record.getMessage() for record in caplog.records if record.name != "websockets.client"]
    assert ours
    for text in (str(ours), shown.out, shown.err, str(answers)):
        assert "very-secret" not in text
    assert "echoavatar_messages_total" in answers[-1][1]


def test_too_many_connections_are_refused_at_the_door(server: RunningServer) -> None:
    from websockets.exceptions import InvalidStatus

    hello = Hello(token="secret")
    with server.call(hello) as source, server.call(hello):
        viewer = Hello(token="secret", role="viewer", session=source.ready.session)
        with server.call(viewer), pytest.raises(InvalidStatus):
            server.call()
        assert server.http("/health")[0] == 200


def test_connections_without_hello_give_way_to_newcomers(server: RunningServer) -> None:
    """Three silent ones take all three places; a client that says hello is served all the same."""
    assert server.empties()
    with server.call() as oldest, server.call(), server.call(), server.call(Hello(token="secret")) as newcomer:
        newcomer.until(Motion)
        code, error = oldest.closing()
    assert code == 4429
    assert error is not None
    assert error.code == "overloaded"


def test_a_body_of_two_lengths_is_refused(server: RunningServer) -> None:
    """A proxy in front may read the other one."""
    host, port = server.address.split(":")
    with socket.create_connection((host, int(port)), 5) as line:
        line.sendall(
            f"POST /v1/voice HTTP/1.1\r\nHost: {host}\r\nContent-Length: 5\r\n".encode()
            + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /health HTTP/1.1\r\n\r\n"
        )
        answer = line.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 400")
    assert answer.count(b"HTTP/1.1") == 1


@pytest.mark.parametrize("path", ["/", "/health", "/avatar.glb", "/v1/tools", "/nowhere"])
def test_every_answer_forbids_what_a_page_does_not_need(server: RunningServer, path: str) -> None:
    line = http.client.HTTPConnection(server.address, timeout=10)
    line.request("GET", path)
    with line.getresponse() as answer:
        headers = answer.headers
    line.close()
    assert "default-src 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert "server" not in headers


def test_no_path_leads_out_of_the_page(server: RunningServer) -> None:
    ways = ("../", "..%2f", "%2e%2e/", "%2e%2e%2f", "..%5c", "....//", "..;/", "%252e%252e%252f", "/")
    goals = ("__init__.py", "echoavatar/__init__.py", "etc/passwd", "etc/passwd%00.js")
    line = http.client.HTTPConnection(server.address, timeout=10)
    for start, way, times, goal in itertools.product(("/", "/assets/", "/sounds/"), ways, (1, 3, 8), goals):
        line.request("GET", f"{start}{way * times}{goal}")
        with line.getresponse() as answer:
            assert (answer.read(), answer.status) == (b"Not Found", 404)
    line.close()
