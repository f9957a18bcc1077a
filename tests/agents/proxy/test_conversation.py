"""Events in, messages to the avatar out; the avatar is a fake that records them."""

import asyncio
import base64
from typing import Any

import numpy as np

from echoavatar.agents.proxy import conversation as room
from echoavatar.agents.proxy.conversation import Conversation
from echoavatar.agents.proxy.events import Event
from echoavatar.wire import Audio, Sound


class Avatar:
    def __init__(self) -> None:
        self.told: list[tuple[str, Any]] = []
        self.seg = 1

    async def speak(self, samples: np.ndarray, *, end: bool = True) -> int:
        self.told.append(("end" if end else "chunk", len(samples)))
        return self.seg

    async def interrupt(self, heard: int | None = None) -> None:
        self.told.append(("interrupt", heard))

    async def send(self, message: Any) -> None:
        self.told.append(("send", message))


def delta(seconds: float, item: str = "a", **more: Any) -> Event:
    data = np.ones(round(24_000 * seconds), "<i2").tobytes()
    return Event("response.output_audio.delta", item_id=item, delta=base64.b64encode(data).decode(), **more)


async def test_an_item_without_its_end_ends_with_the_next_or_with_its_response() -> None:
    avatar, conversation = Avatar(), Conversation()
    await conversation.on_server_event(delta(0.3, "a", response_id="r"), avatar, 0.0)  # type: ignore[arg-type]
    await conversation.on_server_event(delta(0.1, "b", response_id="s"), avatar, 0.1)  # type: ignore[arg-type]
    assert avatar.told == [("chunk", 6_400), ("chunk", 6_400), ("end", 0)]
    await conversation.on_server_event(Event("response.done", response={"id": "s"}), avatar, 0.2)  # type: ignore[arg-type]
    assert avatar.told[3:] == [("chunk", 6_400), ("end", 0)]
    await conversation.on_server_event(delta(0.3, "b"), avatar, 0.3)  # type: ignore[arg-type]
    assert len(avatar.told) == 5  # late sound of an item that has ended


async def test_without_a_word_of_the_client_the_cut_is_where_playback_should_be(monkeypatch: Any) -> None:
    monkeypatch.setattr(room, "GRACE_S", 0.01)
    avatar, conversation = Avatar(), Conversation()
    await conversation.on_server_event(delta(2.0), avatar, 10.0)  # type: ignore[arg-type]
    for chunk in range(7):
        conversation.on_avatar_sound(Sound(at=64_000 + 6_400 * chunk, epoch=0, seg=1, pcm=b""))
    await conversation.on_server_event(Event("input_audio_buffer.speech_started"), avatar, 10.5)  # type: ignore[arg-type]
    assert conversation.is_cutting
    await asyncio.sleep(0.05)
    assert avatar.told[-1] == ("interrupt", 64_000 + 12_000)
    assert not conversation.is_cutting
    said = len(avatar.told)
    await conversation.on_server_event(delta(2.0), avatar, 10.6)  # type: ignore[arg-type]
    truncate = Event("conversation.item.truncate", item_id="a", audio_end_ms=495)
    await conversation.on_client_event(truncate, avatar, 10.7)  # type: ignore[arg-type]
    assert len(avatar.told) == said  # late sound, and a truncation that confirms the estimate
    truncate.audio_end_ms = 300
    await conversation.on_client_event(truncate, avatar, 10.7)  # type: ignore[arg-type]
    assert avatar.told[-1] == ("interrupt", 64_000 + 7_200)


async def test_a_session_that_is_not_cut_by_the_user_goes_on() -> None:
    avatar, conversation = Avatar(), Conversation()
    session = {"turn_detection": {"interrupt_response": False}}
    await conversation.on_server_event(Event("session.updated", session=session), avatar, 0.0)  # type: ignore[arg-type]
    await conversation.on_server_event(delta(2.0), avatar, 0.0)  # type: ignore[arg-type]
    await conversation.on_server_event(Event("input_audio_buffer.speech_started"), avatar, 0.5)  # type: ignore[arg-type]
    assert not conversation.is_cutting


async def test_an_item_whose_beginning_was_missed_gets_no_motion() -> None:
    avatar, conversation = Avatar(), Conversation()
    await conversation.on_server_event(delta(0.5), None, 0.0)
    await conversation.on_server_event(delta(0.5), avatar, 0.1)  # type: ignore[arg-type]
    assert avatar.told == []


async def test_telephone_sound_of_the_user_comes_as_24_khz() -> None:
    avatar, conversation = Avatar(), Conversation()
    session = {"input_audio_format": "g711_ulaw"}
    await conversation.on_server_event(Event("session.created", session=session), avatar, 0.0)  # type: ignore[arg-type]
    event = Event("input_audio_buffer.append", audio=base64.b64encode(b"\x80" * 8_000).decode())
    await conversation.on_client_event(event, avatar, 0.0)  # type: ignore[arg-type]
    sent = [message for kind, message in avatar.told if kind == "send"]
    assert all(isinstance(message, Audio) and message.speaker == "user" for message in sent)
    assert 22_000 < sum(len(message.pcm) // 2 for message in sent) <= 24_000
