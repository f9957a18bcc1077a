"""The remote tools against a real server."""

from collections.abc import Iterator

import pytest
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar.agents.client import ConnectionLostError, RemoteTools
from echoavatar.errors import EchoAvatarError
from echoavatar.wire.messages import ActionStatus, Hello


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving() as server:
        yield server


def test_calls_act_on_the_session_and_their_status_is_reported_to_it(server: RunningServer) -> None:
    with server.call(Hello()) as caller:
        tools = RemoteTools(f"http://{server.address}", session=caller.ready.session)
        assert tools.call("send_action", {"action": "bow"})["status"] == "accepted"
        told = caller.until(ActionStatus)
        assert (told.name, told.status) == ("bow", "accepted")
        title = caller.ready.tracks[0]
        assert tools.call("play_music", {}) == {"status": "accepted", "title": title}
        told = caller.until(ActionStatus, lambda told: told.name == title)
        assert told.status == "accepted"
        assert caller.until(ActionStatus, lambda told: told.name == title).status == "started"
        assert tools.call("stop_music", {}) == {"status": "done"}
        assert caller.until(ActionStatus, lambda told: told.name == "stop").status == "done"
    assert server.empties()


def test_without_a_name_the_newest_session_is_used(server: RunningServer) -> None:
    with server.call(Hello()) as first, server.call(Hello()) as second:
        tools = RemoteTools(server.address)
        assert tools.sessions() == [first.ready.session, second.ready.session]
        assert tools.call("send_action", {"action": "wave"})["status"] == "accepted"
        assert second.until(ActionStatus).name == "wave"
        assert not any(isinstance(told, ActionStatus) for told in first.heard)
    assert server.empties()


def test_failed_calls_are_rejected_not_raised(server: RunningServer) -> None:
    nobody = RemoteTools(server.address).call("send_action", {"action": "wave"})
    assert nobody["status"] == "rejected"
    assert "no session yet: open http" in nobody["reason"]
    with server.call(Hello()):
        tools = RemoteTools(server.address)
        assert "there are: wave, bow" in tools.call("send_action", {"action": "fly"})["reason"]
        assert "there are: send_action" in tools.call("fly away", {})["reason"]
    gone = RemoteTools("http://127.0.0.1:9")
    assert "echoavatar serve" in gone.call("stop_music", {})["reason"]
    with pytest.raises(ConnectionLostError):
        gone.schemas()


def test_declarations_come_in_every_style(server: RunningServer) -> None:
    tools = RemoteTools(server.address)
    assert [tool["name"] for tool in tools.schemas("mcp")][:2] == ["send_action", "play_music"]
    with pytest.raises(EchoAvatarError, match="style is one of"):
        tools.schemas("nonsense")


def test_the_token_is_required_and_accepted() -> None:
    from dataclasses import replace

    with serving(settings=replace(FAST, token="secret")) as server:
        with pytest.raises(EchoAvatarError, match="wrong token"):
            RemoteTools(server.address).sessions()
        assert RemoteTools(server.address, token="secret").sessions() == []
