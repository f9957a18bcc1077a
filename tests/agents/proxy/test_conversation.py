"""Events in, messages to the avatar out; the avatar is a fake that records them."""

import asyncio
import base64
import time
from typing import Any

import numpy as np
import pytest

from echoavatar.agents.proxy import conversation as room
from echoavatar.agents.proxy.conversation import Conversation, Decoder, SpeechItem, SpeechItems
from echoavatar.agents.proxy.events import Event
from echoavatar.timing import CHUNK_SAMPLES, ChunkSize
from echoavatar.wire.messages import Audio, Sound


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


# G.711: codes at both ends and in the middle, with their 16-bit samples
MU = {0x00: -32_124, 0x7F: 0, 0x80: 32_124, 0xFF: 0, 0xF0: 120, 0x70: -120}
A = {0xD5: 8, 0x55: -8, 0xAA: 32_256, 0x2A: -32_256, 0xC5: 264}


def voice(item: str = "a", begun: float = 0.0) -> SpeechItem:
    return SpeechItem(item, "r", 0, 0, Decoder(), begun=begun)


def test_only_whole_chunks_are_made_and_the_last_is_padded_with_silence() -> None:
    one = voice()
    chunks = one.add(np.ones(CHUNK_SAMPLES + 100, "<i2").tobytes()) + one.end()
    assert [len(chunk) for chunk in chunks] == [CHUNK_SAMPLES] * 2
    assert (chunks[1].sum(), one.samples) == (100, CHUNK_SAMPLES + 100)


def test_chunks_are_as_long_as_the_avatars() -> None:
    one = SpeechItem("a", "r", 0, 0, Decoder(), begun=0.0, chunk=ChunkSize(3))
    chunks = one.add(np.ones(10_000, "<i2").tobytes()) + one.end()
    assert [len(chunk) for chunk in chunks] == [9_600, 9_600]
    for at in (19_200, 28_800):
        one.note_returned(at)
    assert (one.clock_at(9_700), one.frame(1), one.speech(1).sum()) == (28_900, 12, 400)


def test_samples_are_found_on_the_avatars_clock_across_gaps() -> None:
    one = voice()
    one.add(np.ones(3 * CHUNK_SAMPLES, "<i2").tobytes())
    for at in (12_800, 32_000, 38_400, 32_000):
        one.note_returned(at)
    assert [one.clock_at(s) for s in (0, 6_399, 6_400, 12_800, 19_200, 19_201)] == [
        12_800,
        19_199,
        32_000,
        38_400,
        44_800,
        None,
    ]
    one.void(32_500)
    assert one.clock == [12_800, 32_000]


def test_the_playing_item_is_estimated_from_when_its_sound_arrived() -> None:
    items = SpeechItems()
    first, second = voice("a", 10.0), voice("b", 10.1)
    items.begin(first)
    first.add(np.ones(24_000, "<i2").tobytes())
    first.end()
    items.begin(second)
    second.add(np.ones(24_000, "<i2").tobytes())
    assert second.begun == 11.0  # it follows the first
    assert items.playing_at(9.0) is None
    assert items.playing_at(10.5) is first
    assert items.playing_at(11.5) is second
    assert items.playing_at(12.2) is second  # more sound may come
    assert items.playing_at(13.0) is None  # it has stalled
    assert (first.heard(10.5), first.heard(99.0)) == (12_000, 24_000)


def test_speech_is_silent_from_where_it_was_cut() -> None:
    one = voice()
    one.add(np.ones(2 * CHUNK_SAMPLES, "<i2").tobytes())
    one.cut = CHUNK_SAMPLES + 100
    assert (one.speech(0).sum(), one.speech(1).sum(), one.speech(7).sum()) == (CHUNK_SAMPLES, 100, 0)


@pytest.mark.parametrize(("kind", "table"), [("ulaw", MU), ("alaw", A)])
def test_telephone_codes_are_those_of_the_standard(kind: str, table: dict[int, int]) -> None:
    made = Decoder(kind, 24_000).push(bytes(table))
    assert made.tolist() == list(table.values())


def test_pcm_may_be_cut_anywhere() -> None:
    samples = np.arange(-500, 500, dtype="<i2")
    decoder, data = Decoder(), samples.tobytes()
    parts = [decoder.push(data[start : start + 7]) for start in range(0, len(data), 7)]
    np.testing.assert_array_equal(np.concatenate(parts), samples)


def test_other_rates_come_to_24_khz_and_nothing_is_lost_at_the_end() -> None:
    tone = (10_000 * np.sin(2 * np.pi * 440 * np.arange(8_000) / 8_000)).astype("<i2")
    decoder = Decoder("pcm", 8_000)
    made = np.concatenate([decoder.push(tone.tobytes()), decoder.push(b"", is_last=True)])
    assert len(made) == 24_000
    expected = 10_000 * np.sin(2 * np.pi * 440 * np.arange(24_000) / 24_000)
    assert np.abs(made - expected)[500:-500].max() < 100


async def test_minutes_of_sound_in_one_event_leave_the_event_loop_to_others() -> None:
    """Of the model, by which the avatar speaks, and of the user at a telephone's rate."""
    conversation, turns = Conversation(), [0.0]

    async def other() -> None:
        while True:
            began = time.thread_time()
            await asyncio.sleep(0)
            turns.append(time.thread_time() - began)

    watching = asyncio.create_task(other())
    await asyncio.sleep(0)
    avatar: Any = Avatar()
    await conversation.on_server_event(delta(45.0), avatar, 0.0)
    session = {"input_audio_format": "g711_ulaw"}
    await conversation.on_server_event(Event("session.created", session=session), avatar, 0.0)
    loud = base64.b64encode(bytes(3_000_000)).decode()
    await conversation.on_client_event(Event("input_audio_buffer.append", audio=loud), avatar, 0.0)
    await asyncio.sleep(0)
    watching.cancel()
    assert len(turns) > 100
    assert max(turns) < 0.1
    sent = [message for what, message in avatar.told if what == "send"]
    assert sum(len(message.pcm) for message in sent) == pytest.approx(2 * 3 * 3_000_000, rel=0.01)
