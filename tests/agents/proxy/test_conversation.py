"""Events in, messages to the avatar out; the avatar is a fake that records them."""

import asyncio
import base64
import time
from typing import Any

import numpy as np
import pytest

from echoavatar.agents.proxy import conversation as room
from echoavatar.agents.proxy.conversation import Conversation
from echoavatar.agents.proxy.events import Event
from echoavatar.wire.messages import Audio, Sound


class Avatar:
    def __init__(self) -> None:
        self.told: list[tuple[str, Any]] = []
        self.seg = 1

    async def speak(self, samples: np.ndarray, *, end: bool = True) -> int:
        self.told.append(("end" if end else "chunk", len(samples)))
        return self.seg

    async def words(self, words: Any, *, seg: int) -> None:
        self.told.append(("words", (seg, words)))

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


async def run(events: "list[tuple[float, Event]]", *, conversation: Conversation | None = None) -> Avatar:
    """What the avatar is told by these events of the server, or of the client if the time is negative."""
    avatar, talk = Avatar(), conversation or Conversation()
    for now, event in events:
        take = talk.on_client_event if now < 0 else talk.on_server_event
        await take(event, avatar, abs(now))  # type: ignore[arg-type]
    return avatar


def speech(seconds: float, **fields: Any) -> Event:
    """A delta with these fields only."""
    event = delta(seconds)
    return Event(event.type, delta=event.delta, **fields)


NAMES: dict[str, list[Event]] = {
    "by response": [speech(0.3, response_id="r"), Event("response.done", response={"id": "r"})],
    "by response.created": [
        Event("response.created", response={"id": "r"}), speech(0.3), Event("response.done", response={"id": "r"}),
    ],
    "by the item that was added": [
        Event("response.output_item.added", item={"id": "i", "type": "message", "role": "assistant"}),
        speech(0.3, response_id="r"), Event("response.output_item.done", item={"id": "i"}),
    ],
    "by nothing": [speech(0.3), Event("response.audio.done")],
    "by a number": [
        Event("response.audio.delta", item_id=7, delta=delta(0.3).delta), Event("response.audio.done", item_id=7),
    ],
    "sound in another field": [Event("response.audio.delta", audio=delta(0.3).delta), Event("response.done")],
    "another name": [Event("response.speech.audio.delta", delta=delta(0.3).delta), Event("response.done", response={})],
}  # fmt: skip


@pytest.mark.parametrize("named", NAMES)
async def test_an_item_is_known_by_whatever_names_it(named: str) -> None:
    for turns in (1, 2):  # each time as a new item
        avatar = await run([(0.1 * k, event) for k, event in enumerate(turns * NAMES[named])])
        assert avatar.told == turns * [("chunk", 6_400), ("chunk", 6_400), ("end", 0)]


async def test_sound_after_the_end_or_between_other_items_goes_on_with_its_item() -> None:
    conversation = Conversation()
    events = [speech(0.3, item_id="a"), speech(0.3, item_id="b"), speech(0.2, item_id="a")]
    events += [Event("response.done"), speech(0.1, item_id="b")]
    avatar = await run([(0.01, event) for event in events], conversation=conversation)
    assert [size for kind, size in avatar.told if kind == "chunk"] == 5 * [6_400]
    assert [(item.item_id, item.frame(0)) for item in conversation.items] == [("a", 0), ("b", 0), ("a", 9), ("b", 9)]
    truncate = Event("conversation.item.truncate", item_id="a", audio_end_ms=400)
    await conversation.on_client_event(truncate, avatar, 0.02)  # type: ignore[arg-type]
    assert [item.cut for item in conversation.items] == [None, None, 2_400, 0]


def word(text: Any, at_ms: Any, item: str = "a", ms: Any = None) -> Event:
    return Event("response.audio_timestamp.delta", item_id=item, audio_offset_ms=at_ms, audio_duration_ms=ms, text=text)


async def test_azures_words_are_told_with_the_sound_of_their_item() -> None:
    early = [(0.0, word("Over", 50, ms=150)), (0.0, delta(0.1)), (0.0, word("there", 200.0)), (0.0, delta(0.3))]
    late = [(0.1, word("and", 350)), (0.1, word(7, 360)), (0.1, word("here", "soon")), (0.1, word("now", None))]
    told = (await run([*early, *late])).told
    assert told == [
        ("chunk", 6_400),
        ("words", (1, [("Over", 0.05, 0.2), ("there", 0.2)])),
        ("words", (1, [("and", 0.35)])),
    ]


async def test_words_of_the_second_part_of_an_item_count_from_there_and_those_that_are_cut_are_dropped() -> None:
    parts = [(0.0, delta(1.0)), (0.0, Event("response.output_audio.done", item_id="a")), (0.1, delta(1.0))]
    events = [*parts, (0.1, word("there", 1_500)), (0.2, Event("response.cancel")), (0.2, word("gone", 1_900))]
    told = (await run(events)).told
    assert [what for kind, what in told if kind == "words"] == [(1, [("there", 0.5)])]


async def test_words_whose_sound_never_came_are_not_those_of_the_next_response() -> None:
    events = [word("gone", 100), Event("response.created", response={"id": "r"}), delta(0.3, response_id="r")]
    assert (await run([(0.0, event) for event in events])).told == [("chunk", 6_400)]


async def test_a_pause_of_the_server_moves_what_is_heard() -> None:
    conversation = Conversation()
    await run([(1.0, speech(0.5, item_id="a")), (1.8, speech(0.5, item_id="a"))], conversation=conversation)
    (item,) = conversation.items
    assert item.heard(2.0) == pytest.approx(24_000 * 0.7, abs=1)
    await run([(9.0, speech(0.5, item_id="a"))], conversation=conversation)  # long after: the rest was shown
    assert [item.first for item in conversation.items] == [0, 24_000]


@pytest.mark.parametrize(
    "stop",
    [
        (-1, Event("response.cancel")),
        (-1, Event("response.cancel", response_id="r")),
        (-1, Event("output_audio_buffer.clear")),
        (1, Event("output_audio_buffer.cleared", response_id="r")),
        (1, Event("response.cancelled", response={"id": "r"})),
        (1, Event("response.done", response={"id": "r", "status": "cancelled"})),
    ],
)
async def test_a_cancelled_response_ends_where_playback_should_be(
    stop: tuple[int, Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "GRACE_S", 0.01)
    side, event = stop
    conversation = Conversation()
    avatar = await run([(10.0, delta(2.0, response_id="r"))], conversation=conversation)
    for chunk in range(7):
        conversation.on_avatar_sound(Sound(at=64_000 + 6_400 * chunk, epoch=0, seg=1, pcm=b""))
    take = conversation.on_client_event if side < 0 else conversation.on_server_event
    await take(event, avatar, 10.5)  # type: ignore[arg-type]
    await asyncio.sleep(0.05)
    assert avatar.told[-1] == ("interrupt", 64_000 + 12_000)
    said = len(avatar.told)
    done = Event("response.done", response={"id": "r"})
    for late in (delta(1.0, response_id="r"), delta(1.0, "c", response_id="r"), done):
        await conversation.on_server_event(late, avatar, 10.6)  # type: ignore[arg-type]
    truncate = Event("conversation.item.truncate", item_id="a", audio_end_ms=500)
    await conversation.on_client_event(truncate, avatar, 10.7)  # type: ignore[arg-type]
    assert len(avatar.told) == said
    await conversation.on_server_event(delta(0.3, "b", response_id="s"), avatar, 10.8)  # type: ignore[arg-type]
    assert avatar.told[said:] == [("chunk", 6_400)]


async def test_the_client_that_cancels_and_truncates_is_believed() -> None:
    conversation = Conversation()
    avatar = await run([(10.0, delta(2.0, response_id="r"))], conversation=conversation)
    conversation.on_avatar_sound(Sound(at=64_000, epoch=0, seg=1, pcm=b""))
    for event in (Event("response.cancel"), Event("conversation.item.truncate", item_id="a", audio_end_ms=100)):
        await conversation.on_client_event(event, avatar, 10.5)  # type: ignore[arg-type]
    assert [told for told in avatar.told if told[0] == "interrupt"] == [("interrupt", 64_000 + 2_400)]
    assert not conversation.is_cutting


async def test_what_is_said_next_is_not_cut_with_what_was_cancelled() -> None:
    """The next response may begin before the client's report could come."""
    conversation = Conversation()
    avatar = await run([(10.0, delta(2.0, response_id="r"))], conversation=conversation)
    await run([(-10.5, Event("response.cancel"))], conversation=conversation)
    await conversation.on_client_event(Event("response.cancel"), avatar, 10.5)  # type: ignore[arg-type]
    for event in (Event("response.created", response={"id": "s"}), delta(0.3, "b", response_id="s")):
        await conversation.on_server_event(event, avatar, 10.55)  # type: ignore[arg-type]
    late = Event("conversation.item.truncate", item_id="a", audio_end_ms=100)
    await conversation.on_client_event(late, avatar, 10.6)  # type: ignore[arg-type]
    await asyncio.sleep(room.GRACE_S + 0.05)
    assert avatar.told[-1] == ("chunk", 6_400)
    assert [item.cut for item in conversation.items] == [12_000, None]


async def test_another_response_is_cancelled() -> None:
    conversation = Conversation()
    avatar = await run([(10.0, delta(2.0, response_id="r"))], conversation=conversation)
    await conversation.on_client_event(Event("response.cancel", response_id="other"), avatar, 10.5)  # type: ignore[arg-type]
    done = Event("response.done", response={"id": "other", "status": "cancelled"})
    await conversation.on_server_event(done, avatar, 10.5)  # type: ignore[arg-type]
    assert not conversation.is_cutting
    assert [item.cut for item in conversation.items] == [None]


CANCEL, CREATE = (-1.0, Event("response.cancel")), (-1.0, Event("response.create"))
CREATED, DONE = (1.1, Event("response.created")), (1.3, Event("response.done", response={"status": "cancelled"}))
LATE, NEXT = (1.2, speech(0.3)), (1.4, speech(0.6))
EARLY = {  # the client cancels before sound has come, which names nothing; only the last sound is spoken
    "a server that names its responses": [(1.0, Event("response.created", response={"id": "r"})), CANCEL, LATE, DONE,
                                          (1.4, Event("response.created", response={"id": "s"})), NEXT],
    "a server that names nothing": [(1.0, CREATED[1]), CANCEL, LATE, LATE, DONE, CREATED, NEXT],
    "a server that only says when it is done": [CANCEL, LATE, LATE, DONE, NEXT],
    "a server that only says when a part is done": [CANCEL, LATE, (1.3, Event("response.audio.done")), NEXT],
    "before the server begins": [CREATE, CANCEL, CREATED, LATE, DONE, CREATE, CREATED, NEXT],
    "the same with names": [CREATE, CANCEL, (1.1, Event("response.created", response={"id": "r"})), LATE, DONE,
                            (1.4, Event("response.created", response={"id": "s"})), NEXT],
    "another is asked for at once": [(1.0, CREATED[1]), CANCEL, CREATE, LATE, DONE, CREATED, NEXT],
    "what was asked for was refused": [CREATE, (1.0, Event("error")), CANCEL, CREATED, NEXT],
    "nothing was there to cancel": [CANCEL, CREATED, NEXT],
    "and long ago": [CANCEL, (9.0, speech(0.6))],
    "the user spoke": [(1.0, Event("input_audio_buffer.speech_started")), NEXT],
    "after its first sound": [(1.0, speech(0.1)), CANCEL, LATE, DONE, NEXT],
}  # fmt: skip


@pytest.mark.parametrize("when", EARLY)
async def test_what_is_cancelled_before_its_sound_comes_is_not_spoken_and_the_next_response_is(when: str) -> None:
    avatar = await run(EARLY[when])
    assert [size for kind, size in avatar.told if kind == "chunk"] == 2 * [6_400]


OPUS = Event("session.created", session={"output_audio_format": "opus"})
UNREADABLE: dict[str, list[Event]] = {
    "no base64": [Event("response.audio.delta", item_id="a", delta="***")],
    "no text": [Event("response.audio.delta", item_id="a", delta={"data": "AAA="})],
    "no sound": [Event("response.audio.delta", item_id="a")],
    "another encoding": [OPUS, delta(0.3)],
    "a file": [Event("response.audio.delta", item_id="a", delta=base64.b64encode(b"OggS" + bytes(9_000)).decode())],
}


@pytest.mark.parametrize("what", UNREADABLE)
async def test_what_cannot_be_read_is_told_once(what: str, caplog: pytest.LogCaptureFixture) -> None:
    conversation = Conversation()
    avatar = await run([(0.0, event) for event in 3 * UNREADABLE[what]], conversation=conversation)
    assert not [told for told in avatar.told if told[0] == "chunk"]
    (record,) = caplog.records
    assert UNREADABLE[what][-1].type in record.getMessage()
    assert "pcm16" in record.getMessage()


async def test_empty_sound_is_nothing_to_tell(caplog: pytest.LogCaptureFixture) -> None:
    avatar = await run([(0.0, Event("response.audio.delta", item_id="a", delta=""))])
    assert avatar.told == []
    assert not caplog.records


async def test_a_format_that_is_told_late_is_that_of_the_rest() -> None:
    conversation = Conversation()
    sent = Event("response.audio.delta", item_id="a", delta=base64.b64encode(bytes(8_000)).decode())
    told = Event("session.updated", session={"output_audio_format": "g711_ulaw"})
    await run([(0.0, sent), (0.0, told), (0.0, sent), (0.0, sent)], conversation=conversation)
    assert [item.samples for item in conversation.items] == [4_000, pytest.approx(48_000, abs=2_000)]


async def test_a_sample_may_be_cut_in_two() -> None:
    data = np.arange(6_400, dtype="<i2").tobytes()
    parts = [base64.b64encode(data[start : start + 1_001]).decode() for start in range(0, len(data), 1_001)]
    avatar = await run([(0.0, Event("response.audio.delta", item_id="a", delta=part)) for part in parts])
    assert avatar.told == [("chunk", 6_400)]


async def seconds_of(events: "list[tuple[float, Event]]") -> float:
    """Seconds that the avatar hears of 8,000 bytes from the server."""
    conversation = Conversation()
    sent = Event("response.audio.delta", item_id="a", delta=base64.b64encode(bytes(8_000)).decode())
    await run([*events, (0.0, sent), (0.0, Event("response.audio.done", item_id="a"))], conversation=conversation)
    return next(iter(conversation.items)).samples / 24_000


@pytest.mark.parametrize(
    ("events", "seconds"),
    [
        ([], 8_000 / 48_000),
        ([(-1, Event("session.update", session={"output_audio_format": "g711_ulaw"}))], 1.0),
        ([(-1, Event("response.create", response={"output_audio_format": "g711_alaw"})),
          (0, Event("response.created", response={"id": "r"}))], 1.0),
        ([(0, Event("session.created", session={"audio": {"output": {"format": {"type": "pcm", "rate": 16_000}}}})),
          (-1, Event("session.update", session={"output_audio_format": "pcm16"}))], 0.25),
        ([(-1, Event("session.update", session={"output_audio_format": "g711_ulaw"})),
          (0, Event("session.updated", session={"output_audio_format": "pcm16"}))], 8_000 / 48_000),
        ([(0, Event("session.updated", session={"output_audio_format": "g711_ulaw"})),
          (0, Event("session.updated", session={"voice": "other"}))], 1.0),
    ],
)  # fmt: skip
async def test_the_format_is_what_the_server_says_or_else_what_the_client_asked_for(
    events: "list[tuple[float, Event]]", seconds: float
) -> None:
    assert await seconds_of(events) == pytest.approx(seconds, abs=0.001)


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
