"""LiveKit's own classes for audio in and out, over a simulated room; no server, no keys."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any

import numpy as np
import pytest

pytest.importorskip("livekit.agents", reason="pip install ./integrations/livekit-plugins-echoavatar")
pytest.importorskip("livekit.plugins.echoavatar", reason="pip install ./integrations/livekit-plugins-echoavatar")

from livekit import api, rtc
from livekit.agents import AgentSession
from livekit.agents.types import USERDATA_TIMED_TRANSCRIPT, TimedString
from livekit.agents.voice.avatar import DataStreamAudioOutput, QueueAudioOutput
from livekit.agents.voice.generation import perform_audio_forwarding
from livekit.plugins.echoavatar import AvatarSession, AvatarWorker, Performer, RemoteAvatarSession
from livekit.plugins.echoavatar.motion import MOTION_TOPIC, TOPIC, MotionChannel
from livekit.plugins.echoavatar.tools import ask_for_tools, function_tools
from tests.agents.integrations.fakes import engine, tone, words_told
from tests.integrations.livekit.rooms import Room, Speaker, pair

from echoavatar.agents.integrations import AvatarBridge, find_backend
from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline.actions import ActionLibrary
from echoavatar.engine.tools import Toolbox
from echoavatar.wire.codec import decode_server
from echoavatar.wire.messages import Flush, Motion, Ready

BLOCK = 2_400


async def speak(sink: Any, samples: np.ndarray) -> None:
    """Push speech as an agent does: faster than playback."""
    for start in range(0, len(samples), BLOCK):
        part = samples[start : start + BLOCK]
        await sink.capture_frame(rtc.AudioFrame(part.tobytes(), 24_000, 1, len(part)))
    sink.flush()


class Scene:
    """A performer between LiveKit's queue and a loudspeaker."""

    def __init__(self, where: Any, *, with_track: bool = True) -> None:
        self.room = Room("agent")
        self.room.local_participant.has_data_tracks = with_track
        self.sink = QueueAudioOutput(sample_rate=24_000, wait_playback_start=True)
        self.speaker = Speaker()
        self.bridge = AvatarBridge(find_backend(where))
        channel = MotionChannel(self.room)  # type: ignore[arg-type]
        self.performer = Performer(self.bridge, self.sink, self.speaker, channel)
        self.events: list[tuple[str, Any]] = []
        self.sink.on("playback_started", lambda event: self.events.append(("started", event)))
        self.sink.on("playback_finished", lambda event: self.events.append(("finished", event)))

    @property
    def frames(self) -> list[rtc.DataTrackFrame]:
        return self.room.local_participant.data_tracks[0].frames

    @property
    def motions(self) -> list[Motion]:
        found = [decode_server(frame.payload) for frame in self.frames]
        return [message for message in found if isinstance(message, Motion)]

    def told(self, kind: type) -> list[Any]:
        found = [decode_server(payload) for topic, payload, _ in self.room.data if topic == TOPIC]
        return [message for message in found if isinstance(message, kind)]

    async def until(self, what: Callable[[], bool], seconds: float = 15.0) -> None:
        async with asyncio.timeout(seconds):
            while not what():  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    def is_hearing(self, samples: int) -> Callable[[], bool]:
        return lambda: bool(self.speaker.queued_duration >= 0) and len(self.speaker.heard) > samples


def play(script: Callable[[Scene], Awaitable[None]], where: Any = None, **options: Any) -> Scene:
    async def run() -> Scene:
        scene = Scene(where or engine(), **options)
        await scene.performer.start()
        try:
            await script(scene)
        finally:
            await scene.performer.close()
        return scene

    return asyncio.run(run())


def test_playback_is_reported_as_it_was() -> None:
    said = tone(1.3)

    async def script(scene: Scene) -> None:
        await speak(scene.sink, said)
        assert not scene.events, "nothing is heard yet"
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 20)
        assert not event.interrupted
        assert event.playback_position == pytest.approx(1.3, abs=1e-3)

    scene = play(script)
    assert [name for name, _ in scene.events] == ["started", "finished"]
    np.testing.assert_allclose(scene.speaker.heard[: len(said)], said, atol=1)


def test_motion_is_sent_before_its_sound_with_the_time_at_which_that_is_heard() -> None:
    due: list[tuple[int, int, float]] = []  # frames sent before, samples, when they are heard

    async def script(scene: Scene) -> None:
        capture = scene.speaker.capture_frame

        async def noting(frame: rtc.AudioFrame) -> None:
            due.append((len(scene.frames), frame.samples_per_channel, time.time() + scene.speaker.queued_duration))
            await capture(frame)

        scene.speaker.capture_frame = noting  # type: ignore[method-assign]
        await scene.until(lambda: len(scene.frames) > 5)  # silence, which is released ahead and not handed over
        await speak(scene.sink, tone(1.0))
        await asyncio.wait_for(scene.sink.wait_for_playout(), 20)

    scene = play(script)
    assert due
    stamps = [frame.user_timestamp for frame in scene.frames]
    assert None not in stamps
    for count, samples, heard in due:
        assert scene.motions[count - 1].frames * 800 == samples
        assert (stamps[count - 1] or 0) / 1e6 == pytest.approx(heard, abs=0.1)
    assert scene.told(Ready)


def test_without_data_tracks_motion_goes_as_reliable_data() -> None:
    async def script(scene: Scene) -> None:
        await speak(scene.sink, tone(0.5))
        await asyncio.wait_for(scene.sink.wait_for_playout(), 20)

    scene = play(script, with_track=False)
    assert not scene.room.local_participant.data_tracks
    payloads = [payload for topic, payload, _ in scene.room.data if topic == MOTION_TOPIC]
    assert len(payloads) >= 2
    assert all(isinstance(decode_server(payload), Motion) for payload in payloads)


def test_a_full_track_loses_motion_and_a_lost_track_is_replaced() -> None:
    async def script(scene: Scene) -> None:
        track = scene.room.local_participant.data_tracks[0]
        await scene.until(lambda: len(track.frames) > 1)
        track.is_full = True
        await asyncio.sleep(0.6)
        assert not [1 for topic, _, _ in scene.room.data if topic == MOTION_TOPIC]
        track.is_there = False
        await scene.until(lambda: any(topic == MOTION_TOPIC for topic, _, _ in scene.room.data))

    play(script)


def test_an_interruption_tells_how_much_was_heard() -> None:
    async def script(scene: Scene) -> None:
        await speak(scene.sink, tone(4.0))
        await scene.until(scene.is_hearing(24_000))
        scene.sink.clear_buffer()
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 5)
        assert event.interrupted
        heard = len(scene.speaker.heard) / 24_000
        assert event.playback_position == pytest.approx(heard, abs=0.03)
        await asyncio.sleep(0.7)
        assert len(scene.speaker.heard) / 24_000 == pytest.approx(heard, abs=0.04), "stale sound was heard"

    scene = play(script)
    flush = scene.told(Flush)[-1]
    after = [motion for motion in scene.motions if motion.epoch == flush.epoch]
    assert after, "the avatar froze"
    assert after[0].at == flush.at


def test_interrupted_twice_in_a_row_and_it_speaks_again() -> None:
    async def script(scene: Scene) -> None:
        for _ in range(2):
            before = len(scene.speaker.heard)
            await speak(scene.sink, tone(4.0))
            await scene.until(scene.is_hearing(before + 12_000))
            scene.sink.clear_buffer()
            scene.sink.clear_buffer()
            event = await asyncio.wait_for(scene.sink.wait_for_playout(), 5)
            assert event.interrupted
            assert event.playback_position == pytest.approx((len(scene.speaker.heard) - before) / 24_000, abs=0.03)
        await speak(scene.sink, tone(0.6))
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 20)
        assert (event.interrupted, round(event.playback_position, 2)) == (False, 0.6)

    scene = play(script)
    assert [name for name, _ in scene.events].count("finished") == 3


def test_interrupted_before_anything_was_heard() -> None:
    async def script(scene: Scene) -> None:
        await speak(scene.sink, tone(2.0))
        await asyncio.sleep(0.02)
        scene.sink.clear_buffer()
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 5)
        assert event.interrupted
        assert event.playback_position < 0.1

    play(script)


def test_an_interruption_during_music_leaves_the_music() -> None:
    title = Tracks().titles[0]
    track = Tracks().load(title)

    async def script(scene: Scene) -> None:
        await scene.bridge._session.play_music(title)
        await scene.until(scene.is_hearing(24_000))
        scene.sink.clear_buffer()
        scene.sink.clear_buffer()
        before = len(scene.speaker.heard)
        await scene.until(scene.is_hearing(before + 24_000))
        await speak(scene.sink, tone(3.0))
        await scene.until(lambda: any(name == "started" for name, _ in scene.events))
        await asyncio.sleep(0.3)
        scene.sink.clear_buffer()
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 5)
        assert event.interrupted
        before = len(scene.speaker.heard)
        await scene.until(scene.is_hearing(before + 12_000))

    scene = play(script)
    sound = scene.speaker.heard.astype(float) / 32_767
    np.testing.assert_allclose(sound[:20_000], track[:20_000], atol=1e-3)
    piece = sound[34_000:40_000]
    lags = range(-12_000, 12_001)  # a busy machine leaves gaps in what is heard
    fits = [np.median(np.abs(track[34_000 + lag : 40_000 + lag] - piece)) for lag in lags]
    assert min(fits) < 1e-3, "after the interruption it is another music"
    assert {motion.state for motion in scene.motions} >= {"dancing"}
    assert np.abs(sound[-8_000:]).max() > 0.01, "the music stopped"


def timed(samples: np.ndarray, *text: TimedString, rate: int = 24_000) -> rtc.AudioFrame:
    return rtc.AudioFrame(samples.tobytes(), rate, 1, len(samples), userdata={USERDATA_TIMED_TRANSCRIPT: list(text)})


def test_timed_transcripts_become_the_words_of_their_segment() -> None:
    told: list[tuple[int, str, float]] = []

    async def script(scene: Scene) -> None:
        nonlocal told
        told = words_told(scene.bridge)
        await scene.sink.capture_frame(timed(tone(0.5), TimedString("Over ", 0.1, 0.3), TimedString("th", 0.4, 0.5)))
        await scene.sink.capture_frame(timed(tone(0.5), TimedString("ere", 0.5), TimedString(" untimed ")))
        scene.sink.flush()
        await asyncio.wait_for(scene.sink.wait_for_playout(), 20)
        await scene.sink.capture_frame(timed(tone(3.0), TimedString("you", 0.2)))
        scene.sink.flush()
        await scene.until(lambda: len([1 for name, _ in scene.events if name == "started"]) == 2)
        await scene.sink.capture_frame(timed(tone(3.0), TimedString("but ", 0.2), TimedString("gone", 1.0)))
        await scene.until(lambda: len(told) == 4)
        scene.sink.clear_buffer()
        scene.sink.flush()
        await asyncio.wait_for(scene.sink.wait_for_playout(), 20)
        await scene.sink.capture_frame(timed(tone(0.5), TimedString("me ", 0.1)))
        await scene.until(lambda: len(told) == 5)

    play(script)
    assert told == [(1, "Over", 0.1), (1, "there", 0.4), (2, "you", 0.2), (3, "but", 0.2), (4, "me", 0.1)]


async def test_words_survive_the_agents_forwarding_of_a_voice_at_another_rate() -> None:
    session: AgentSession[None] = AgentSession()
    avatar = AvatarSession(engine())
    await avatar.start(session, Room("agent"))  # type: ignore[arg-type]
    told = words_told(avatar.bridge)

    async def voice() -> AsyncIterator[rtc.AudioFrame]:
        for word, start in (("over ", 0.1), ("there ", 0.6)):
            yield timed(tone(0.5, 16_000), TimedString(word, start, start + 0.2), rate=16_000)

    assert session.output.audio is not None
    task, out = perform_audio_forwarding(
        audio_output=session.output.audio, tts_output=voice(), reconcile_playout_pause=lambda: None
    )
    await asyncio.wait_for(task, 10)
    event = await asyncio.wait_for(session.output.audio.wait_for_playout(), 20)
    assert event.playback_position == pytest.approx(1.0, abs=1e-3)
    assert told == [(1, "over", 0.1), (1, "there", 0.6)]
    out.first_frame_fut.cancel()
    await avatar.aclose()


def test_set_manner_is_a_tool_where_the_avatar_has_it() -> None:
    schemas = Toolbox(ActionLibrary({}), Tracks(), has_manner=True).schemas()
    asked: list[Any] = []

    async def call(name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        asked.append((name, arguments))
        return {"status": "done"}

    tools = {tool.info.name: tool for tool in function_tools(schemas, call)}
    assert asyncio.run(tools["set_manner"](raw_arguments={"liveliness": 0.9})) is None
    assert asked == [("set_manner", {"liveliness": 0.9})]


async def test_livekits_own_source_is_understood() -> None:
    """`rtc.AudioSource` needs no room; its queue gives the playback position."""
    scene = Scene(engine())
    source = rtc.AudioSource(24_000, 1, queue_size_ms=1_000)
    scene.performer._source = source
    await scene.performer.start()
    await speak(scene.sink, tone(1.0))
    event = await asyncio.wait_for(scene.sink.wait_for_playout(), 20)
    assert (event.interrupted, round(event.playback_position, 2)) == (False, 1.0)
    await speak(scene.sink, tone(3.0))
    await scene.until(lambda: len([1 for name, _ in scene.events if name == "started"]) == 2)
    await asyncio.sleep(0.5)
    scene.sink.clear_buffer()
    event = await asyncio.wait_for(scene.sink.wait_for_playout(), 5)
    assert event.interrupted
    assert 0.3 < event.playback_position < 0.9
    await scene.performer.close()
    await source.aclose()


async def test_a_session_in_process_takes_the_agents_voice_and_leaves_the_agent_alone() -> None:
    room = Room("agent")
    session: AgentSession[None] = AgentSession()
    avatar = AvatarSession(engine())
    await avatar.start(session, room)  # type: ignore[arg-type]
    assert avatar.avatar_identity == "agent"
    assert avatar.provider == "echoavatar"
    assert len(room.local_participant.tracks) == 1
    await avatar.wait_for_join(timeout=5)
    tools = {tool.info.name: tool for tool in avatar.tools}
    assert set(tools) == {"send_action", "play_music", "stop_music", "list_actions"}
    action = tools["send_action"].info.raw_schema["parameters"]["properties"]["action"]
    assert action["enum"] == ["wave", "bow"]
    assert await tools["send_action"](raw_arguments={"action": "wave"}) is None, "gestures are silent"
    told = json.loads(await tools["send_action"](raw_arguments={"action": "fly"}))
    assert told["status"] == "rejected"
    assert session.output.audio is not None
    assert session.output.audio.sample_rate is None
    await speak(session.output.audio, tone(0.5))
    event = await asyncio.wait_for(session.output.audio.wait_for_playout(), 20)
    assert (event.interrupted, round(event.playback_position, 2)) == (False, 0.5)
    room.emit("participant_connected", type("Guest", (), {"identity": "guest"})())
    await asyncio.sleep(0.1)
    assert any(to == ["guest"] for _, _, to in room.data)
    await avatar.aclose()
    assert not room.local_participant.tracks


async def test_a_worker_hears_the_agent_and_tells_it_the_truth() -> None:
    """Agent and worker, connected by LiveKit's own data stream and RPC."""
    agent, avatar = pair("agent", "echoavatar")
    speaker = Speaker()
    worker = AvatarWorker(avatar, engine(), source=speaker)  # type: ignore[arg-type]
    await worker.start()
    sink = DataStreamAudioOutput(
        agent,  # type: ignore[arg-type]
        destination_identity="echoavatar",
        sample_rate=24_000,
        wait_playback_start=True,
    )
    started: list[Any] = []
    sink.on("playback_started", started.append)
    await speak(sink, tone(0.8))
    event = await asyncio.wait_for(sink.wait_for_playout(), 20)
    assert (event.interrupted, round(event.playback_position, 2)) == (False, 0.8)
    assert len(started) == 1
    for _ in range(2):
        before = len(speaker.heard)
        await speak(sink, tone(4.0))
        async with asyncio.timeout(10):
            while speaker.queued_duration < 0 or len(speaker.heard) < before + 12_000:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        sink.clear_buffer()
        event = await asyncio.wait_for(sink.wait_for_playout(), 5)
        assert event.interrupted
        heard = (len(speaker.heard) - before) / 24_000
        assert event.playback_position == pytest.approx(heard, abs=0.05)
    assert avatar.local_participant.data_tracks[0].frames
    tools = {tool.info.name: tool for tool in await ask_for_tools(agent, "echoavatar")}  # type: ignore[arg-type]
    assert await tools["send_action"](raw_arguments={"action": "bow"}) is None
    assert list(json.loads(await tools["list_actions"](raw_arguments={}))["actions"]) == ["wave", "bow"]
    await worker.close()


def test_a_workers_token_names_the_agent_it_publishes_for() -> None:
    avatar = RemoteAvatarSession()
    secret = "s" * 32
    token = avatar.worker_token("room", "agent-1", api_key="key", api_secret=secret)
    claims = api.TokenVerifier("key", secret).verify(token)
    assert claims.identity == "echoavatar"
    assert claims.attributes == {"lk.publish_on_behalf": "agent-1"}
    assert claims.kind == "agent"


@pytest.mark.slow
def test_the_default_bundle_speaks_and_is_interrupted() -> None:
    async def script(scene: Scene) -> None:
        await speak(scene.sink, tone(3.0))
        await scene.until(scene.is_hearing(24_000), 120)
        scene.sink.clear_buffer()
        event = await asyncio.wait_for(scene.sink.wait_for_playout(), 10)
        assert event.interrupted
        await asyncio.sleep(1.0)

    scene = play(script, where="default")
    assert len({motion.rotations for motion in scene.motions}) == len(scene.motions)
