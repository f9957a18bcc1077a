"""The official OpenAI client through the proxy, with nothing changed but the URL."""

import asyncio
import base64

import pytest
from tests.agents.proxy.places import avatar_server, proxied, tone
from tests.agents.proxy.scripted import ScriptedSession

from echoavatar.agents.proxy import ProxySettings

openai = pytest.importorskip("openai")


async def talk(session: ScriptedSession) -> None:
    """Wait for `response.create`, answer, be interrupted, wave, and answer again."""
    await session.until("response.create")
    speaking = asyncio.create_task(
        session.say(
            tone(6.0), pace=0.4, until=lambda: any(e["type"] == "input_audio_buffer.append" for e in session.received)
        )
    )
    await session.until("input_audio_buffer.append")
    await session.send("input_audio_buffer.speech_started", audio_start_ms=10, item_id="item_user")
    await speaking
    await session.until("conversation.item.truncate")
    await session.send("conversation.item.truncated", item_id="item_1", content_index=0, audio_end_ms=600)
    await session.call("send_action", '{"action": "wave"}', response="resp_2")
    await session.until("response.create", 2)
    await session.say(tone(1.0), item="item_3", response="resp_3")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
async def test_a_conversation_with_interruption_and_gesture() -> None:
    settings = ProxySettings("ws://x", tools=True)
    kinds: list[str] = []
    heard: dict[str, int] = {}
    frames: dict[str, set[int]] = {}
    with avatar_server() as server:
        async with proxied(talk, server.address, settings=settings) as (url, upstream, _):
            client = openai.AsyncOpenAI(api_key="sk-test", websocket_base_url=url.removesuffix("/realtime"))
            async with client, client.realtime.connect(model="gpt-realtime") as connection:
                async for event in connection:
                    kinds.append(event.type)
                    match event.type:
                        case "session.created":
                            await connection.session.update(session={"type": "realtime", "instructions": "Be brief."})
                        case "echoavatar.session.created":
                            assert len(event.rig["names"]) == 52
                            await connection.response.create()
                        case "response.output_audio.delta":
                            heard[event.item_id] = heard.get(event.item_id, 0) + len(base64.b64decode(event.delta))
                        case "response.animation_blendshapes.delta":
                            assert len(event.frames[0]) == 52
                            frames.setdefault(event.item_id, set()).add(event.frame_index)
                            if event.item_id == "item_1" and len(frames["item_1"]) == 3:
                                await connection.input_audio_buffer.append(audio=base64.b64encode(tone(0.1)).decode())
                        case "input_audio_buffer.speech_started":
                            await connection.conversation.item.truncate(
                                item_id="item_1", content_index=0, audio_end_ms=600
                            )
                        case "response.animation_blendshapes.done" if event.item_id == "item_3":
                            break
            assert 0 < heard["item_1"] < len(tone(6.0))
            assert heard["item_3"] == len(tone(1.0))
            assert frames["item_3"] == {0, 8, 16, 24}
            assert "echoavatar.flush" in kinds
            assert "echoavatar.action_status" in kinds
            [(path, headers)] = upstream.requests
            assert path == "/v1/realtime?model=gpt-realtime"
            assert headers["Authorization"] == "Bearer sk-test"
