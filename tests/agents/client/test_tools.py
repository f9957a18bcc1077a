"""The remote tools against a real server."""

from collections.abc import Iterator

import pytest
from tests.server.fakes import FAST, Place, serving

from echoavatar.agents.client import ConnectionLostError, RemoteTools
from echoavatar.errors import EchoAvatarError
from echoavatar.wire import ActionStatus, Hello


@pytest.fixture(scope="module")
def place() -> Iterator[Place]:
    with serving() as place:
        yield place


def test_calls_act_on_the_session_and_their_status_is_reported_to_it(place: Place) -> None:
    with place.call(Hello()) as caller:
        tools = RemoteTools(f"http://{place.address}", session=caller.ready.session)
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
    assert place.empties()


def test_without_a_name_the_newest_session_is_used(place: Place) -> None:
    with place.call(Hello()) as first, place.call(Hello()) as second:
        tools = RemoteTools(place.address)
        assert tools.sessions() == [first.ready.session, second.ready.session]
        assert tools.call("send_action", {"action": "wave"})["status"] == "accepted"
        assert second.until(ActionStatus).name == "wave"
        assert not any(isinstance(told, ActionStatus) for told in first.heard)
    assert place.empties()


def test_failed_calls_are_rejected_not_raised(place: Place) -> None:
    nobody = RemoteTools(place.address).call("send_action", {"action": "wave"})
    assert nobody["status"] == "rejected"
    assert "not here" in nobody["reason"]
    with place.call(Hello()):
        tools = RemoteTools(place.address)
        assert "there are: wave, bow" in tools.call("send_action", {"action": "fly"})["reason"]
        assert "there are: send_action" in tools.call("fly away", {})["reason"]
    gone = RemoteTools("http://127.0.0.1:9")
    assert "echoavatar serve" in gone.call("stop_music", {})["reason"]
    with pytest.raises(ConnectionLostError):
        gone.schemas()


def test_declarations_come_in_every_style(place: Place) -> None:
    tools = RemoteTools(place.address)
    assert [tool["name"] for tool in tools.schemas("mcp")][:2] == ["send_action", "play_music"]
    with pytest.raises(EchoAvatarError, match="style is one of"):
        tools.schemas("nonsense")


def test_the_token_is_required_and_accepted() -> None:
    from dataclasses import replace

    with serving(settings=replace(FAST, token="secret")) as place:
        with pytest.raises(EchoAvatarError, match="wrong token"):
            RemoteTools(place.address).sessions()
        assert RemoteTools(place.address, token="secret").sessions() == []
