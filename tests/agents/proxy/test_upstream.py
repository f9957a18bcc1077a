import pytest

from echoavatar.agents.client.connection import quiet_logger
from echoavatar.agents.proxy import ProxySettings
from echoavatar.agents.proxy.upstream import forwarded_headers, upstream_url
from echoavatar.errors import EchoAvatarError


def test_the_query_is_both_and_the_client_decides() -> None:
    base = "wss://x.example/v1/realtime?model=a&api-version=1"
    assert upstream_url(base, "/v1/realtime?model=b%20c") == ("wss://x.example/v1/realtime?api-version=1&model=b+c")
    assert upstream_url("ws://h:1/x", "/anything") == "ws://h:1/x"


def test_headers_of_this_one_connection_stay_here() -> None:
    given = [
        ("Authorization", "Bearer k"),
        ("Host", "127.0.0.1"),
        ("Sec-WebSocket-Key", "x"),
        ("Upgrade", "websocket"),
        ("Origin", "http://localhost"),
        ("Cookie", "a=b"),
        ("X-Custom", "1"),
        ("api-key", "k"),
    ]
    assert forwarded_headers(given) == [("Authorization", "Bearer k"), ("X-Custom", "1"), ("api-key", "k")]


def test_the_connection_logs_nothing_at_debug_level() -> None:
    assert not quiet_logger().isEnabledFor(10)


@pytest.mark.parametrize("url", ["", "https://api.openai.com/v1/realtime", "wss://", "api.openai.com", "wss://a:x"])
def test_an_invalid_upstream_is_refused_with_an_example(url: str) -> None:
    with pytest.raises(EchoAvatarError, match="wss://api.openai.com"):
        ProxySettings(url)
