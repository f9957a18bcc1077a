"""The scripted upstream sends events that the official client accepts."""

import json

import pytest
from tests.agents.proxy.places import listening, tone
from tests.agents.proxy.scripted import ScriptedSession, ScriptedUpstream


async def script(session: ScriptedSession) -> None:
    await session.say(tone(0.25))
    await session.call("send_action", "{}", response="resp_2")
    await session.websocket.close()


async def test_its_events_are_those_that_openai_documents() -> None:
    async with ScriptedUpstream(script) as upstream, listening(upstream.url) as client:
        await client.listen()
        kinds = [json.loads(text)["type"] for text in client.passed]
        assert kinds[:2] == ["session.created", "response.created"]
        assert kinds.count("response.output_audio.delta") == 3
        realtime = pytest.importorskip("openai.types.realtime")
        from pydantic import TypeAdapter

        known = TypeAdapter(realtime.RealtimeServerEvent)
        for text in client.passed:
            if not json.loads(text)["type"].startswith("response.created"):
                assert known.validate_json(text).type in kinds
