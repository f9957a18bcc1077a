"""The avatar beside the voice: its frames, interruptions, tools, and its failures."""

import asyncio
import base64
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any
from unittest.mock import AsyncMock, Mock

import numpy as np
import pytest
from tests.agents.proxy.places import FacedBody, Listener, listening, proxied, silent, talking, tone
from tests.agents.proxy.scripted import ScriptedSession
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from echoavatar.agents.proxy import ProxySettings
from echoavatar.agents.proxy.sidecar import AvatarSidecar
from echoavatar.timing import ChunkSize
from echoavatar.wire.blobs import unpack_pose
from echoavatar.wire.codec import encode, subprotocol
from echoavatar.wire.messages import Latency, Limits, Motion, Ready, Rig, Sound

BODY, FACE, FLUSH = ("echoavatar.animation_body.delta", "response.animation_blendshapes.delta", "echoavatar.flush")
DONE = "response.animation_blendshapes.done"
LEVEL = 8_000 / 32_768


def heights(event: dict[str, Any]) -> float:
    """How much the body has heard so far, in seconds of `tone`; see `tests.server.fakes.Body`."""
    blobs = {key: base64.b64decode(event[key]) for key in ("rotations", "root")}
    pose = unpack_pose(Motion(at=0, epoch=0, frames=event["frames"], face=b"", state="idle", **blobs), curves=52)
    return float(pose.root[-1, 1]) / 1e-5 / LEVEL / 24_000


def is_there(client: Listener) -> bool:
    return bool(client.of("echoavatar.session.created"))


async def speak_when_told(session: ScriptedSession) -> None:
    """Send one second at once, after the client's `go`."""
    await session.until("go")
    await session.say(tone(1.0))


async def test_every_frame_of_an_item_comes_with_its_place_and_nothing_of_the_voice_is_missing() -> None:
    async with talking(speak_when_told) as (client, upstream, _):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: bool(c.of(DONE)))
        assert client.passed == upstream.sessions[0].sent
        own = {"response_id": "resp_1", "item_id": "item_1", "output_index": 0, "content_index": 0}
        faces, bodies = client.of(FACE), [e for e in client.of(BODY) if e["item_id"]]
        for events in (faces, bodies):
            assert [event["frame_index"] for event in events] == [0, 8, 16, 24]
            assert all(event.items() >= own.items() for event in events)
        assert [len(event["frames"]) for event in faces] == [8] * 4
        assert all(len(row) == 52 for event in faces for row in event["frames"])
        np.testing.assert_allclose([heights(e) for e in bodies], [0.267, 0.533, 0.8, 1.0], atol=2e-3)
        assert client.of(DONE)[0].items() >= own.items()
        told = client.of("echoavatar.session.created")[0]
        assert (len(told["rig"]["names"]), len(told["blendshapes"])) == (52, 52)
        await client.listen(lambda c: any(event["item_id"] is None for event in c.of(BODY)))
        idle = [event for event in client.of(BODY) if event["item_id"] is None]
        assert all(event["face"] and event["frame_index"] is None for event in idle)


async def test_an_avatar_of_longer_steps_has_its_own_count() -> None:
    """A bundle imported with `--step 3` moves by 12 frames."""
    async with talking(speak_when_told, pipeline=FacedBody(chunk=ChunkSize(3))) as (client, upstream, _):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: bool(c.of(DONE)))
        assert client.passed == upstream.sessions[0].sent
        bodies = [event for event in client.of(BODY) if event["item_id"]]
        assert [event["frame_index"] for event in bodies] == [0, 12, 24]
        assert [len(event["frames"]) for event in client.of(FACE)] == [12] * 3
        np.testing.assert_allclose([heights(e) for e in bodies], [0.4, 0.8, 1.0], atol=2e-3)


async def test_idle_frames_can_be_left_out() -> None:
    settings = ProxySettings("ws://x", idle=False)
    async with talking(speak_when_told, settings=settings) as (client, _, _):
        await client.listen(is_there)
        await asyncio.sleep(0.5)
        await client.say("go")
        await client.listen(lambda c: bool(c.of(DONE)))
        assert {event["item_id"] for event in client.of(BODY)} == {"item_1"}


async def speak_long(session: ScriptedSession) -> None:
    """Send eight seconds at twice the speed of playback until the user speaks; then one second more."""
    await session.until("go")
    speaking = asyncio.create_task(
        session.say(tone(8.0), pace=0.5, until=lambda: any(e.get("type") == "user" for e in session.received))
    )
    await session.until("user")
    await session.send("input_audio_buffer.speech_started", audio_start_ms=0, item_id="user_1")
    await speaking
    await session.until("conversation.item.truncate")
    await session.send("conversation.item.truncated", item_id="item_1", content_index=0, audio_end_ms=1_000)
    await session.say(tone(1.0), item="item_2", response="resp_2")


@pytest.mark.parametrize("heard_ms", [500, 1_200])
async def test_speech_that_was_not_heard_leaves_no_trace_in_the_body(heard_ms: int) -> None:
    """The user interrupts after about 1.5 s and the client reports what was heard; the body forgets the rest."""
    async with talking(speak_long) as (client, upstream, _):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: len(c.of(FACE)) >= 3)
        await asyncio.sleep(0.7)
        await client.say("user")
        await client.listen(lambda c: any("speech_started" in text for text in c.passed))
        await client.say("conversation.item.truncate", item_id="item_1", content_index=0, audio_end_ms=heard_ms)
        await client.listen(lambda c: any(e["item_id"] == "item_2" for e in c.of(DONE)))
        [session] = upstream.sessions
        assert client.passed == session.sent
        second = [event for event in client.of(BODY) if event["item_id"] == "item_2"]
        assert [event["frame_index"] for event in second] == [0, 8, 16, 24]
        assert heights(second[-1]) == pytest.approx(1 + heard_ms / 1_000, abs=0.01)
        flushes = client.of(FLUSH)
        assert flushes
        assert flushes[0]["item_id"] == "item_1"
        place_of = {event["frame_index"]: event["at"] for event in client.of(BODY) if event["item_id"] == "item_1"}
        start = place_of[0]
        assert [flush["at"] - start for flush in flushes] == [pytest.approx(heard_ms * 24, abs=801)]


async def push_to_talk(session: ScriptedSession) -> None:
    """A server of another dialect: its sound names no item, and comes in lines of URL-safe base64 without padding."""
    await session.until("go")
    await session.send("response.created", response={"id": "resp_1"})
    sentence = tone(15.0)
    for start in range(0, len(sentence), 4_801):  # samples are cut in two
        data = base64.urlsafe_b64encode(sentence[start : start + 4_801]).decode().rstrip("=")
        lines = "\n".join(data[at : at + 76] for at in range(0, len(data), 76))
        await session.send_text(json.dumps({"type": "response.audio.delta", "response_id": "resp_1", "delta": lines}))
    await session.until("response.cancel")
    await session.send("response.done", response={"id": "resp_1", "status": "cancelled", "output": []})
    await session.say(tone(1.0), item="item_2", response="resp_2")


async def test_a_client_that_only_cancels_stops_the_avatar(caplog: pytest.LogCaptureFixture) -> None:
    """After 3.7 s of motion, which comes at most 2 s and a chunk ahead of playback: at least 1.4 s were heard."""
    async with talking(push_to_talk) as (client, upstream, _):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: any(event["frame_index"] >= 13 * 8 for event in c.of(FACE)))
        await client.say("response.cancel")
        await client.listen(lambda c: any(e["item_id"] == "item_2" for e in c.of(DONE)))
        assert client.passed == upstream.sessions[0].sent
        (flush,) = client.of(FLUSH)
        assert flush["item_id"] == "resp_1", "an item without a name is called after its response"
        first, second = ([e for e in client.of(BODY) if e["item_id"] == name] for name in ("resp_1", "item_2"))
        assert [event["frame_index"] for event in second] == [0, 8, 16, 24]
        last = max((event for event in first if event["at"] <= flush["at"]), key=lambda event: event["frame_index"])
        heard_s = last["frame_index"] / 30 + min(flush["at"] - last["at"], 6_400) / 24_000  # a busy server may pause
        assert 1.4 < heard_s < 14.9, "in the middle of the sentence"
        assert heights(second[-1]) == pytest.approx(1 + heard_s, abs=0.05)
    assert not [record for record in caplog.records if "proxy" in record.name]


async def test_sound_that_cannot_be_read_passes_and_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    async def script(session: ScriptedSession) -> None:
        await session.until("go")
        for _ in range(5):
            await session.send("response.output_audio.delta", item_id="a", delta="{not base64}")
            await session.websocket.send(bytes(range(256)))
        await session.say(tone(0.5), item="item_2", response="resp_2")

    async with talking(script) as (client, _, _):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: any(e["item_id"] == "item_2" for e in c.of(DONE)))
    (record,) = [record for record in caplog.records if record.name.endswith("proxy.conversation")]
    assert "response.output_audio.delta" in record.getMessage()


async def test_interrupted_twice_in_a_row() -> None:
    async def script(session: ScriptedSession) -> None:
        await session.until("go")
        for turn in (1, 2):
            kind = f"user_{turn}"
            speaking = asyncio.create_task(
                session.say(
                    tone(6.0),
                    item=f"item_{turn}",
                    response=f"resp_{turn}",
                    pace=0.3,
                    until=lambda kind=kind: any(e.get("type") == kind for e in session.received),
                )
            )
            await session.until(kind)
            await session.send("input_audio_buffer.speech_started")
            await speaking
            await session.until("conversation.item.truncate", turn)
        await session.say(tone(0.8), item="item_3", response="resp_3")

    async with talking(script) as (client, upstream, _):
        await client.listen(is_there)
        await client.say("go")
        for turn in (1, 2):
            item = f"item_{turn}"
            await client.listen(lambda c, item=item: sum(e["item_id"] == item for e in c.of(FACE)) >= 3)
            await client.say(f"user_{turn}")
            await client.say("conversation.item.truncate", item_id=item, content_index=0, audio_end_ms=400)
        await client.listen(lambda c: any(e["item_id"] == "item_3" for e in c.of(DONE)))
        last = [event for event in client.of(BODY) if event["item_id"] == "item_3"][-1]
        assert heights(last) == pytest.approx(0.4 + 0.4 + 0.8, abs=0.02)
        assert client.passed == upstream.sessions[0].sent


async def test_when_the_avatar_dies_in_mid_sentence_the_voice_goes_on_and_it_may_come_back() -> None:
    async def script(session: ScriptedSession) -> None:
        await session.until("go")
        await session.say(tone(4.0), pace=0.5)
        await session.until("again")
        await session.say(tone(0.6), item="item_2", response="resp_2")

    async with talking(script) as (client, upstream, server):
        await client.listen(is_there)
        await client.say("go")
        await client.listen(lambda c: bool(c.of(FACE)))
        [session] = server.manager._sessions.values()
        session.collect = None  # its next step raises, and the server ends the session as failed
        await client.listen(lambda c: any('"response.done"' in text for text in c.passed))
        assert client.passed == upstream.sessions[0].sent
        await client.listen(lambda c: len(c.of("echoavatar.session.created")) == 2)
        await client.say("again")
        await client.listen(lambda c: any(e["item_id"] == "item_2" for e in c.of(DONE)))


def ready(**wrong: Any) -> bytes:
    given: dict[str, Any] = {
        "rig": Rig(names=("hips",), parents=(-1,), rest=((0.0, 1.0, 0.0),)),
        "latency": Latency(algorithm=0, compute=0),
        "limits": Limits(),
        **dict.fromkeys(("server", "session", "resume"), "x"),
        **dict.fromkeys(("at", "epoch", "seg", "received"), 0),
        **dict.fromkeys(("face", "actions", "tracks"), ()),
        **{"version": 1, "resumed": False, "sample_rate": 24_000, "frame_rate": 30, "chunk_samples": 6_400},
    }
    return encode(Ready(**given | wrong))


BLOBS = {"rotations": b"x", "root": bytes(5), "face": b"yy"}
LIES = {
    "hangs": [],
    "noise": [b"\xc1" * 40],
    "text": ["hello"],
    "no chunk": [ready(chunk_samples=0)],
    "huge chunk": [ready(chunk_samples=2**60)],
    "frames that are not there": [ready(), encode(Motion(at=0, epoch=0, frames=2**40, state="idle", **BLOBS))],
    "half a sample": [ready(), encode(Sound(at=2**50, epoch=9, seg=5, pcm=b"odd"))],
}


@pytest.mark.parametrize("frames", LIES.values(), ids=LIES)
async def test_an_avatar_that_lies_or_hangs_leaves_the_voice_whole(frames: list[bytes | str]) -> None:
    async def lie(socket: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            await socket.recv()
            for frame in frames:
                await socket.send(frame)
            await socket.wait_closed()

    protocols = [Subprotocol(subprotocol("msgpack"))]
    async with serve(lie, "127.0.0.1", 0, subprotocols=protocols, compression=None) as liar:
        avatar = f"127.0.0.1:{next(iter(liar.sockets)).getsockname()[1]}"
        async with proxied(speak_when_told, avatar) as (url, upstream, _), listening(url) as client:
            await client.say("go")
            await client.listen(lambda c: any('"response.done"' in text for text in c.passed), seconds=5)
            if frames:
                await client.listen(lambda c: bool(c.added), seconds=5)  # the lie has arrived
            assert client.passed == upstream.sessions[0].sent


@pytest.mark.parametrize("avatar", ["127.0.0.1:9", ""])
async def test_without_an_avatar_it_is_a_plain_relay(avatar: str) -> None:
    async with proxied(speak_when_told, avatar) as (url, upstream, _), listening(url) as client:
        await client.say("go")
        await client.listen(lambda c: any('"response.done"' in text for text in c.passed))
        if avatar:
            await client.listen(lambda c: bool(c.of("echoavatar.session.lost")))
            assert "echoavatar serve" in client.of("echoavatar.session.lost")[0]["reason"]
        assert client.passed == upstream.sessions[0].sent


async def call_and_go_on(session: ScriptedSession) -> None:
    await session.until("session.update")
    await session.until("go")
    await session.call("send_action", '{"action": "bow"}')
    await session.until("response.create")
    await session.call("play_music", "{}", call="call_2", response="resp_2")
    await session.until("conversation.item.create", 2)


async def test_the_model_is_offered_the_tools_and_its_calls_are_carried_out() -> None:
    settings = ProxySettings("ws://x", tools=True)
    async with talking(call_and_go_on, settings=settings) as (client, upstream, _):
        await client.listen(lambda c: any('"session.updated"' in text for text in c.passed))
        await client.say("go")
        await client.listen(lambda c: bool(c.of("echoavatar.music.delta")))
        [session] = upstream.sessions
        await session.until("conversation.item.create", 2)
        update, done = (session.received[0], [e for e in session.received if e["type"] == "conversation.item.create"])
        assert update["session"]["type"] == "realtime"
        assert [tool["name"] for tool in update["session"]["tools"]][:2] == ["send_action", "play_music"]
        answers = [json.loads(event["item"]["output"]) for event in done]
        assert [event["item"]["call_id"] for event in done] == ["call_1", "call_2"]
        assert [answer["status"] for answer in answers] == ["accepted", "accepted"]
        statuses = [(e["name"], e["status"]) for e in client.of("echoavatar.action_status")]
        assert ("bow", "accepted") in statuses


async def test_music_is_heard_beside_the_voice_and_the_voice_is_taken_out_of_it() -> None:
    """The avatar hears voice and music; the client gets the voice from upstream, and only the music from here."""

    async def script(session: ScriptedSession) -> None:
        await session.until("session.update")
        await session.call("play_music", "{}")
        await session.until("go")
        await session.say(tone(2.0, level=12_000))

    settings = ProxySettings("ws://x", tools=True)
    async with talking(script, settings=settings) as (client, _, _):
        await client.listen(lambda c: bool(c.of("echoavatar.music.delta")))
        await client.say("go")
        await client.listen(lambda c: bool(c.of(DONE)))
        spoken = {event["at"] for event in client.of(BODY) if event["item_id"]}
        music = [event for event in client.of("echoavatar.music.delta") if event["at"] in spoken]
        assert len(music) >= 6
        import base64

        for event in music:
            samples = np.frombuffer(base64.b64decode(event["delta"]), "<i2").astype(float)
            assert abs(samples.mean()) < 1_200  # the voice has level 12,000 throughout
        assert max(np.abs(np.frombuffer(base64.b64decode(e["delta"]), "<i2")).max() for e in music) > 50


async def test_the_users_voice_makes_the_avatar_listen() -> None:
    import base64

    async with talking(silent) as (client, _, _):
        await client.listen(is_there)
        time = np.arange(24_000) / 24_000
        voice = (6_000 * np.sin(2 * np.pi * 150 * time) * (1 + np.sin(2 * np.pi * 4 * time))).astype("<i2")
        for part in np.array_split(voice, 10):
            await client.say("input_audio_buffer.append", audio=base64.b64encode(part.tobytes()).decode())
        await client.listen(lambda c: any(e["state"] == "listening" for e in c.of(BODY)))


async def test_a_flood_of_events_leaves_the_event_loop_to_others() -> None:
    sidecar = AvatarSidecar(ProxySettings("ws://127.0.0.1:9", avatar="127.0.0.1:9"), client=Mock(), upstream=Mock())
    for _ in range(1_000):
        sidecar.observe('{"type":"x"}', is_server=True)
    reading = asyncio.create_task(sidecar._read())
    for _ in range(10):
        await asyncio.sleep(0)
    assert 900 < len(sidecar._queue) < 1_000
    reading.cancel()


async def test_an_avatar_that_is_down_is_tried_again_after_half_a_second_to_fifteen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ten connections are refused, one is made and lost, and one more is refused; nothing really waits."""
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 12:
            raise asyncio.CancelledError

    @contextlib.asynccontextmanager
    async def reach(*_: object, **__: object) -> AsyncIterator[None]:
        if len(waits) != 10:
            raise ConnectionRefusedError
        yield

    client = AsyncMock(transport=Mock(get_write_buffer_size=lambda: 0))
    sidecar = AvatarSidecar(ProxySettings("ws://x", avatar="127.0.0.1:9"), client=client, upstream=Mock())
    sidecar._upstream_spoke.set()
    monkeypatch.setattr(sidecar, "_serve", AsyncMock(side_effect=ConnectionResetError))
    monkeypatch.setattr("echoavatar.agents.proxy.sidecar.connect", reach)
    monkeypatch.setattr(asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await sidecar.run()
    assert waits == [0.5, 1, 2, 4, 8, *[15] * 5, 0.5, 1]
    assert client.send.await_count == 12  # each failure is told
