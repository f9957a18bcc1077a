"""A bridge over a minimal pipeline: what it releases, in which order, and how interruptions cut it."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable

import numpy as np
import pytest
from tests.agents.integrations.fakes import engine, tone, words_told

from echoavatar.agents.client import ConnectionLostError
from echoavatar.agents.integrations import AvatarBridge, AvatarChunk, AvatarTools, Flushed, UtteranceDone
from echoavatar.agents.integrations import bridge as room
from echoavatar.agents.integrations.backend import LocalBackend
from echoavatar.agents.integrations.bridge import SpeechResampler
from echoavatar.agents.integrations.playback import Event
from echoavatar.errors import EchoAvatarError
from echoavatar.wire.messages import ActionStatus, BodyOptions, Error, Ready, State


class Scene:
    def __init__(self) -> None:
        self.bridge = AvatarBridge(LocalBackend(engine()), body=BodyOptions(leash_m=0.5))
        self.events: list[tuple[float, Event]] = []

    def of(self, kind: type) -> list:  # type: ignore[type-arg]
        return [event for _, event in self.events if isinstance(event, kind)]

    @property
    def sound(self) -> np.ndarray:
        parts = [np.frombuffer(chunk.pcm, "<i2") for chunk in self.of(AvatarChunk)]
        return np.concatenate([np.zeros(0, np.int16), *parts])

    async def until(self, what: Callable[[], bool], seconds: float = 15.0) -> None:
        async with asyncio.timeout(seconds):
            while not what():  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async def watch(self) -> None:
        async for event in self.bridge:
            self.events.append((time.monotonic(), event))


@contextlib.asynccontextmanager
async def playing() -> AsyncIterator[Scene]:
    """A bridge that is watched until the block ends."""
    scene = Scene()
    await scene.bridge.start()
    watching = asyncio.ensure_future(scene.watch())
    try:
        yield scene
    finally:
        await scene.bridge.close()
        await asyncio.wait([watching], timeout=5)


async def test_chunks_leave_in_order_shortly_before_they_are_due() -> None:
    async with playing() as scene:
        await scene.bridge.say(tone(2.0), 24_000)
        seg = await scene.bridge.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(UtteranceDone)))
    np.testing.assert_allclose(scene.sound[:48_000], tone(2.0), atol=1)
    chunks = [(when, chunk) for when, chunk in scene.events if isinstance(chunk, AvatarChunk)]
    assert [chunk.at for _, chunk in chunks] == list(range(0, 6_400 * len(chunks), 6_400))
    spoken = [(when, chunk) for when, chunk in chunks if chunk.seg]
    took = spoken[-1][0] - spoken[0][0]
    assert took > (spoken[-1][1].at - spoken[0][1].at) / 24_000 - 0.4, "it ran ahead of playback"
    said = scene.of(UtteranceDone)[-1]
    assert said.at == spoken[0][1].at + 48_000
    assert isinstance(scene.events[0][1], Ready)


class Watch:
    """A clock that stands until it is set, in the place of the module `time`."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


async def test_a_chunk_is_released_a_quarter_of_a_second_before_it_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second is due 0.27 s after the first: it waits at 0.01 s, and leaves at 0.03 s."""
    watch = Watch()
    monkeypatch.setattr(room, "time", watch)
    async with playing() as scene:
        await scene.bridge.say(tone(2.0), 24_000)
        watch.now += 0.01
        await scene.until(lambda: scene.bridge._received_to > 2 * 6_400)
        await asyncio.sleep(0.1)
        assert [chunk.at for chunk in scene.of(AvatarChunk)] == [0]
        watch.now += 0.02
        await scene.until(lambda: len(scene.of(AvatarChunk)) > 1)
        await asyncio.sleep(0.1)
        assert [chunk.at for chunk in scene.of(AvatarChunk)] == [0, 6_400]


async def test_speech_at_any_rate_in_any_blocks_comes_out_whole() -> None:
    async with playing() as scene:
        samples = tone(1.0, 44_100)
        for block in np.array_split(samples, 7):
            await scene.bridge.say(block, 44_100)
        seg = await scene.bridge.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(UtteranceDone)))
    np.testing.assert_allclose(scene.sound[1_000:23_000], tone(1.0)[1_000:23_000].astype(float), atol=60)


async def test_an_interruption_is_exact_and_two_at_once_are_one() -> None:
    async with playing() as scene:
        await scene.bridge.say(tone(4.0), 24_000)
        await scene.until(lambda: len(scene.sound) > 24_000)
        first = next(chunk.at for chunk in scene.of(AvatarChunk) if chunk.seg)
        heard = scene.bridge.playback.position(time.monotonic())
        one, other = await asyncio.gather(scene.bridge.interrupt(), scene.bridge.interrupt())
        assert one is not None
        assert one == other
        assert one.heard == pytest.approx(heard - first, abs=200)
        assert not scene.bridge.is_busy
        await scene.bridge.interrupt()  # with nothing to interrupt it does nothing
        await asyncio.sleep(0.6)
    cut = scene.events.index(next((when, event) for when, event in scene.events if isinstance(event, Flushed)))
    after = [event for _, event in scene.events[cut:] if isinstance(event, AvatarChunk)]
    assert after
    assert not any(chunk.pcm for chunk in after)
    assert after[0].at == scene.of(Flushed)[0].flush.at


async def test_actions_are_answered_and_made_again_motion_overtakes() -> None:
    async with playing() as scene:
        await scene.bridge.say(tone(3.0), 24_000)
        await scene.until(lambda: len(scene.sound) > 12_000)
        await scene.bridge._session.act("wave")
        await scene.bridge._session.act("fly")
        seg = await scene.bridge.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(UtteranceDone)))
    np.testing.assert_allclose(scene.sound[:72_000], tone(3.0), atol=1)
    assert {status.status for status in scene.of(ActionStatus)} >= {"accepted", "started", "rejected"}
    assert not any(cut.is_interruption for cut in scene.of(Flushed))


async def test_music_needs_no_speech_and_ends() -> None:
    async with playing() as scene:
        tools = AvatarTools(scene.bridge, await scene.bridge.backend.tools())
        assert (await tools.call("play_music", {"title": "no such song"}))["status"] == "rejected"
        assert (await tools.call("play_music", {}))["status"] == "accepted"
        await scene.until(lambda: len(scene.sound) > 24_000)
        await tools.call("stop_music", {})
        await scene.until(lambda: scene.of(State)[-1].state == "idle")
    assert "dancing" in {state.state for state in scene.of(State)}
    assert {chunk.seg for chunk in scene.of(AvatarChunk)} == {0}


async def test_timed_text_becomes_the_words_of_its_utterance() -> None:
    async with playing() as scene:
        bridge, told = scene.bridge, words_told(scene.bridge)
        await bridge.words([("Over th", 0.0, 0.7)])
        assert not told, "the utterance may never come"
        await bridge.say(tone(0.5), 24_000)
        await bridge.words([("ere ", 0.7, 1.0)])
        await bridge.say(np.repeat(tone(0.5, 16_000), 2), 16_000, channels=2)
        assert bridge.said_s == 1.0
        await bridge.words([("me", 1.2)])
        await bridge.end()
        assert bridge.said_s == 0
        await bridge.words([("you ", 0.0)])
        await bridge.say(tone(0.5).tobytes(), 24_000)
        assert bridge.said_s == 0.5
        await bridge.end()
        (session,) = bridge.backend._app.state.manager._sessions.values()  # type: ignore[attr-defined]
        await scene.until(lambda: set(session.core._words._words) == {1, 2})
    assert told == [(1, "Over", 0.0), (1, "there", 0.467), (1, "me", 1.2), (2, "you", 0.0)]


async def test_an_interruption_drops_words_that_were_not_told() -> None:
    async with playing() as scene:
        told, refused = words_told(scene.bridge), []
        take = scene.bridge._take
        scene.bridge._take = lambda message: (  # type: ignore[method-assign]
            refused.append(message) if isinstance(message, Error) else take(message)
        )
        await scene.bridge.words([("gone ", 5.0)])
        await scene.bridge.interrupt()
        await scene.bridge.say(tone(2.0), 24_000)
        await scene.bridge.words([("over ", 0.5), ("the", 0.9)])
        await scene.bridge.interrupt()
        await scene.bridge.words([("re ", 0.1)])
        await scene.bridge.say(tone(0.5), 24_000)
        await scene.bridge.end()
        await scene.until(lambda: any(done.seg == 2 for done in scene.of(UtteranceDone)))
    assert told == [(1, "over", 0.5), (2, "re", 0.1)]
    assert not refused


async def test_a_lost_session_is_replaced_and_the_clock_continues() -> None:
    """The server loses the session: speech that was not released is sent again, and the clock never runs backwards.

    The new session stays as near to its place as the lost one.
    """

    def leashes() -> list[float | None]:
        return [session.core.options.leash_m for session in scene.bridge.backend._app.state.manager._sessions.values()]

    async with playing() as scene:
        assert leashes() == [0.5]
        await scene.bridge.say(tone(2.5), 24_000)
        seg = await scene.bridge.end()
        await scene.until(lambda: len(scene.sound) > 12_000)
        manager = scene.bridge.backend._app.state.manager  # type: ignore[attr-defined]
        avatar = scene.bridge._session
        avatar._socket.transport.abort()  # type: ignore[union-attr]
        for session in list(manager._sessions.values()):
            manager.end(session)
        await scene.until(lambda: any(said.seg == seg for said in scene.of(UtteranceDone)))
        assert leashes() == [0.5]
    assert len(scene.of(Ready)) == 2
    at = [chunk.at for chunk in scene.of(AvatarChunk)]
    assert at == sorted(at)
    assert np.count_nonzero(scene.sound) > 0.9 * 60_000


async def test_a_session_that_ended_raises() -> None:
    bridge = AvatarBridge(LocalBackend(engine()))
    with pytest.raises(EchoAvatarError, match="start"):
        await bridge.say(tone(0.1), 24_000)
    await bridge.start()
    await bridge._session.close()
    with pytest.raises(EchoAvatarError, match="gone"):
        async for _ in bridge:
            pass
    await bridge.close()
    await bridge.close()
    assert issubclass(ConnectionLostError, EchoAvatarError)


@pytest.mark.parametrize("rate", [8_000, 16_000, 24_000, 44_100, 48_000])
def test_blocks_make_one_sound_at_our_rate(rate: int) -> None:
    stream = SpeechResampler()
    parts = [stream.push(block, rate) for block in np.array_split(tone(1.0, rate), 9)]
    made = np.concatenate([*parts, stream.flush()])
    assert abs(len(made) - 24_000) <= 1
    np.testing.assert_allclose(made[1_000:23_000], tone(1.0, 24_000)[1_000:23_000], atol=60)


def test_after_a_reset_nothing_old_is_left() -> None:
    stream = SpeechResampler()
    stream.push(tone(0.5, 16_000), 16_000)
    stream.reset()
    made = np.concatenate([stream.push(np.zeros(1_600, np.int16), 16_000), stream.flush()])
    assert np.abs(made).max() <= 1  # soxr dithers


def test_the_rate_may_change() -> None:
    stream = SpeechResampler()
    stream.push(tone(0.1, 16_000), 16_000)
    assert len(stream.push(tone(0.1, 24_000), 24_000)) == 2_400


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("rate", [16_000, 24_000])
def test_samples_come_in_pieces_of_any_length_and_with_any_number_of_channels(rate: int, channels: int) -> None:
    """A service that passes on what it reads from a socket cuts samples in two."""
    mono = tone(0.5, rate)
    data = np.repeat(mono[:, None], channels, axis=1).astype("<i2").tobytes()
    whole, pieces = SpeechResampler(), SpeechResampler()
    expected = np.concatenate([whole.push(mono, rate), whole.flush()])
    got = [pieces.push(data[start : start + 1_001], rate, channels) for start in range(0, len(data), 1_001)]
    np.testing.assert_allclose(np.concatenate([*got, pieces.flush()]), expected, atol=3)


def test_half_a_sample_is_not_kept_for_the_next_utterance() -> None:
    for end in (SpeechResampler.flush, SpeechResampler.reset):
        resampler = SpeechResampler()
        resampler.push(b"\x01\x02\x03", 24_000)
        end(resampler)
        assert resampler.push(b"\x04\x00", 24_000).tolist() == [4]
