"""A model's calls act on the session of a bridge; the prompt names what there is."""

from tests.agents.integrations.fakes import engine

from echoavatar.agents.integrations import AvatarBridge, AvatarTools, find_backend
from echoavatar.agents.integrations.tools import persona


async def test_calls_reach_the_stage() -> None:
    bridge = AvatarBridge(find_backend(engine()))
    ready = await bridge.start()
    tools = AvatarTools(bridge, await bridge.backend.tools())
    assert tools.names == ("send_action", "play_music", "stop_music", "list_actions")
    done = await tools.call("send_action", {"action": "wave", "intensity": 2, "hold": None})
    assert (done["status"], done["action"]) == ("accepted", "wave")
    assert (await tools.call("play_music", {"title": ready.tracks[0]}))["status"] == "accepted"
    assert await tools.call("stop_music", {}) == {"status": "done"}
    assert list((await tools.call("list_actions", {}))["actions"]) == ["wave", "bow"]
    for name, arguments in (("dive", {}), ("send_action", {}), ("send_action", {"action": "fly"})):
        assert (await tools.call(name, arguments))["status"] == "rejected"
    await bridge.close()


def test_the_prompt_lists_actions_and_tracks() -> None:
    text = persona(["wave", "bow"], ["Waltz"], name="Mika", surroundings="The record store is on the right.")
    for told in ("Mika", "wave, bow", "Waltz", "record store", "Producer", "send_action", "play_music", "stop_music"):
        assert told in text
    assert "{" not in text


def test_the_prompt_says_if_there_are_none() -> None:
    assert "none yet" in persona([], [])
