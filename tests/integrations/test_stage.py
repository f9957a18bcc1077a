"""A stage over a body of twenty lines: what leaves, in which order, and what an interruption leaves of it."""

import asyncio
import time
from collections.abc import Awaitable, Callable

import numpy as np
import pytest
from tests.server.fakes import Body

from echoavatar.client import ConnectionLostError
from echoavatar.engine import Engine
from echoavatar.errors import EchoAvatarError
from echoavatar.integrations import Cut, Hop, Said, Stage
from echoavatar.integrations.hop import Event
from echoavatar.integrations.place import Local
from echoavatar.wire import ActionStatus, Ready, State


def tone(seconds: float, rate: int = 24_000) -> np.ndarray:
    time_s = np.arange(round(seconds * rate)) / rate
    return (8_000 * np.sin(2 * np.pi * 220 * time_s)).astype(np.int16)


class Scene:
    def __init__(self) -> None:
        self.stage = Stage(Local(Engine(Body(), seats=2)))  # type: ignore[arg-type]
        self.events: list[tuple[float, Event]] = []

    def of(self, kind: type) -> list:  # type: ignore[type-arg]
        return [event for _, event in self.events if isinstance(event, kind)]

    @property
    def sound(self) -> np.ndarray:
        parts = [np.frombuffer(hop.pcm, "<i2") for hop in self.of(Hop)]
        return np.concatenate([np.zeros(0, np.int16), *parts])

    async def until(self, what: Callable[[], bool], seconds: float = 15.0) -> None:
        async with asyncio.timeout(seconds):
            while not what():  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async def watch(self) -> None:
        async for event in self.stage:
            self.events.append((time.monotonic(), event))


def play(script: Callable[[Scene], Awaitable[None]]) -> Scene:
    async def run() -> Scene:
        scene = Scene()
        await scene.stage.start()
        watching = asyncio.ensure_future(scene.watch())
        try:
            await script(scene)
        finally:
            await scene.stage.close()
            await asyncio.wait([watching], timeout=5)
        return scene

    return asyncio.run(run())


def test_hops_leave_in_order_shortly_before_they_are_due() -> None:
    async def script(scene: Scene) -> None:
        await scene.stage.say(tone(2.0), 24_000)
        seg = await scene.stage.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(Said)))

    scene = play(script)
    np.testing.assert_allclose(scene.sound[:48_000], tone(2.0), atol=1)
    hops = [(when, hop) for when, hop in scene.events if isinstance(hop, Hop)]
    assert [hop.at for _, hop in hops] == list(range(0, 6_400 * len(hops), 6_400))
    spoken = [(when, hop) for when, hop in hops if hop.seg]
    took = spoken[-1][0] - spoken[0][0]
    assert took > (spoken[-1][1].at - spoken[0][1].at) / 24_000 - 0.4, "it ran ahead of playback"
    said = scene.of(Said)[-1]
    assert said.at == spoken[0][1].at + 48_000
    assert isinstance(scene.events[0][1], Ready)


def test_speech_at_any_rate_in_any_blocks_comes_out_whole() -> None:
    async def script(scene: Scene) -> None:
        samples = tone(1.0, 44_100)
        for block in np.array_split(samples, 7):
            await scene.stage.say(block, 44_100)
        seg = await scene.stage.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(Said)))

    scene = play(script)
    np.testing.assert_allclose(scene.sound[1_000:23_000], tone(1.0)[1_000:23_000].astype(float), atol=60)


def test_an_interruption_is_exact_and_two_at_once_are_one() -> None:
    async def script(scene: Scene) -> None:
        await scene.stage.say(tone(4.0), 24_000)
        await scene.until(lambda: len(scene.sound) > 24_000)
        first = next(hop.at for hop in scene.of(Hop) if hop.seg)
        heard = scene.stage.playback.position(time.monotonic())
        one, other = await asyncio.gather(scene.stage.interrupt(), scene.stage.interrupt())
        assert one is not None
        assert one == other
        assert one.heard == pytest.approx(heard - first, abs=200)
        assert not scene.stage.is_busy
        await scene.stage.interrupt()  # nothing to interrupt is no error
        await asyncio.sleep(0.6)

    scene = play(script)
    cut = scene.events.index(next((when, event) for when, event in scene.events if isinstance(event, Cut)))
    after = [event for _, event in scene.events[cut:] if isinstance(event, Hop)]
    assert after
    assert not any(hop.pcm for hop in after)
    assert after[0].at == scene.of(Cut)[0].flush.at


def test_actions_are_answered_and_made_again_motion_overtakes() -> None:
    async def script(scene: Scene) -> None:
        await scene.stage.say(tone(3.0), 24_000)
        await scene.until(lambda: len(scene.sound) > 12_000)
        assert (await scene.stage.act("wave")).status == "accepted"
        refused = await scene.stage.act("fly")
        assert (refused.status, refused.choices) == ("rejected", ("wave", "bow"))
        seg = await scene.stage.end()
        await scene.until(lambda: any(said.seg == seg for said in scene.of(Said)))

    scene = play(script)
    np.testing.assert_allclose(scene.sound[:72_000], tone(3.0), atol=1)
    assert {status.status for status in scene.of(ActionStatus)} >= {"accepted", "started", "rejected"}
    assert not any(cut.is_interruption for cut in scene.of(Cut))


def test_music_needs_no_speech_and_ends() -> None:
    async def script(scene: Scene) -> None:
        assert (await scene.stage.play_music("no such song")).status == "rejected"
        assert (await scene.stage.play_music()).status == "accepted"
        await scene.until(lambda: len(scene.sound) > 24_000)
        await scene.stage.stop_music()
        await scene.until(lambda: scene.of(State)[-1].state == "idle")

    scene = play(script)
    assert "dancing" in {state.state for state in scene.of(State)}
    assert {hop.seg for hop in scene.of(Hop)} == {0}


def test_a_lost_session_is_replaced_and_the_clock_goes_on() -> None:
    """A server that forgot us: what was not handed out yet is said, and no clock runs backwards."""

    async def script(scene: Scene) -> None:
        await scene.stage.say(tone(2.5), 24_000)
        seg = await scene.stage.end()
        await scene.until(lambda: len(scene.sound) > 12_000)
        manager = scene.stage.place._app.state.manager  # type: ignore[attr-defined]
        avatar = scene.stage._there
        avatar._line._close(1006, "")  # type: ignore[union-attr]
        avatar._line._in.put_nowait({"type": "websocket.close"})  # type: ignore[union-attr]
        for live in list(manager._live.values()):
            manager.end(live)
        await scene.until(lambda: any(said.seg == seg for said in scene.of(Said)))

    scene = play(script)
    assert len(scene.of(Ready)) == 2
    at = [hop.at for hop in scene.of(Hop)]
    assert at == sorted(at)
    assert np.count_nonzero(scene.sound) > 0.9 * 60_000


def test_what_cannot_go_on_is_told() -> None:
    async def run() -> None:
        stage = Stage(Local(Engine(Body())))  # type: ignore[arg-type]
        with pytest.raises(EchoAvatarError, match="start"):
            await stage.say(tone(0.1), 24_000)
        await stage.start()
        await stage._there.close()
        with pytest.raises(EchoAvatarError, match="gone"):
            async for _ in stage:
                pass
        await stage.close()
        await stage.close()

    asyncio.run(run())
    assert issubclass(ConnectionLostError, EchoAvatarError)
