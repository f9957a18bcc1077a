"""Video of a session over WebRTC: a flash and a beep through the whole chain, and the ways a viewer comes and goes."""

import asyncio
import dataclasses
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("aiortc", reason="pip install 'echoavatar[video]'")

import aioice.ice
from tests.server.fakes import FAST, RunningServer, serving
from tests.server.video.flashes import PERIOD, Flasher, beeps, runs
from tests.server.video.webrtc import Watcher, http

from echoavatar.errors import DependencyError
from echoavatar.files.avatar.avatar_renderer import RENDERERS
from echoavatar.files.avatar.render import Renderer, Surface
from echoavatar.server import ServerSettings
from echoavatar.server.clients import ClientRates
from echoavatar.wire.messages import Hello
from echoavatar.wire.rates import Rate

ENOUGH_HZ = 15  # pictures a second below which flashes are not judged
AT_ONCE = 20  # flashes in one message, which has a limit
VIDEO = dataclasses.replace(FAST, video=1, video_size=(128, 128), resume_seconds=5.0)


def until(what: Callable[[], bool], seconds: float = 15.0) -> bool:
    end = time.monotonic() + seconds
    while not what() and time.monotonic() < end:
        time.sleep(0.05)
    return what()


def free(server: RunningServer) -> int:
    return int(server.http("/health")[1]["video"]["free"])


async def watch(server: RunningServer, watcher: Watcher, path: str = "/v1/whep", **headers: str) -> str:
    offer = await watcher.offer()
    status, told, text = await asyncio.to_thread(
        http, "POST", f"http://{server.address}{path}", offer.encode(), **headers
    )
    assert status == 201, text
    assert told["content-type"].startswith("application/sdp")
    await watcher.accept(text)
    return f"http://{server.address}{told['location']}"


async def measure(settings: ServerSettings, flashes: int) -> Watcher:
    """Watch so many flashes with their beeps."""
    watcher = Watcher()
    with (
        serving(settings=settings, pipeline=Flasher()) as server,
        server.call(Hello(want=()), ping_interval=None) as caller,
    ):
        try:
            address = await watch(server, watcher)
            await watcher.until(lambda: len(watcher.pictures) > 3 and len(watcher.sounds) > 10)
            for seg, first in enumerate(range(0, flashes, AT_ONCE), 1):
                count = min(flashes - first, AT_ONCE)
                await asyncio.to_thread(caller.speak, seg, beeps(count))
                await asyncio.sleep((count + 1) * PERIOD / 24_000)
            await asyncio.sleep(PERIOD / 48_000)
            assert (await asyncio.to_thread(http, "DELETE", address))[0] == 200
            assert await asyncio.to_thread(until, lambda: free(server) == 1)
        finally:
            await watcher.close()
    return watcher


def test_flash_and_beep_are_seen_and_heard_together() -> None:
    """The edges of a flash are known to half the interval between two pictures; a busy machine leaves pictures out."""
    watcher = asyncio.run(measure(VIDEO, 2))
    assert watcher.last is not None
    assert watcher.last.shape == (128, 128, 3)
    (offsets, doubts), rate = watcher.offsets(), watcher.rate()
    if rate < ENOUGH_HZ:
        pytest.skip(f"{rate:.0f} pictures a second are too few to time flashes (from {ENOUGH_HZ} on)")
    assert len(offsets) >= 1
    assert abs(offsets.mean()) < max(0.020, doubts.mean()), (offsets, doubts)
    assert (np.abs(offsets) < np.maximum(0.060, 0.020 + doubts)).all(), (offsets, doubts)


@pytest.mark.slow
def test_a_hundred_flashes_at_full_size() -> None:
    """The issue's bound: mean within 20 ms, 99 % within 60 ms."""
    watcher = asyncio.run(asyncio.wait_for(measure(dataclasses.replace(VIDEO, video_size=(512, 512)), 100), 200))
    (offsets, _), rate = watcher.offsets(), watcher.rate()
    sys.stdout.write(
        f"\n{len(offsets)} flashes, {rate:.1f} pictures a second; flash after beep: mean {1e3 * offsets.mean():.1f} ms,"
        f" 99 % within {1e3 * np.percentile(np.abs(offsets), 99):.0f} ms\n"
    )
    if rate < ENOUGH_HZ:
        pytest.skip(f"{rate:.0f} pictures a second are too few to time flashes (from {ENOUGH_HZ} on)")
    assert len(offsets) > 90
    assert abs(offsets.mean()) < 0.020
    assert np.percentile(np.abs(offsets), 99) < 0.060


async def test_renderers_are_bounded_and_each_end_frees_one() -> None:
    with serving(settings=VIDEO, pipeline=Flasher()) as server:
        one, two, three = Watcher(), Watcher(), Watcher()
        caller = server.call(Hello(want=()))
        try:
            address = await watch(server, one, f"/v1/sessions/{caller.ready.session}/whep?view=bust&background=dusk")
            status, told, text = await asyncio.to_thread(
                http, "POST", f"http://{server.address}/v1/whep", (await two.offer()).encode()
            )
            assert (status, int(told["retry-after"])) == (503, 5), text
            assert (await asyncio.to_thread(http, "DELETE", address))[0] == 200
            assert (await asyncio.to_thread(http, "DELETE", address))[0] == 404
            address = await watch(server, three)
            assert await asyncio.to_thread(until, lambda: len(three.pictures) > 2)
            caller.__exit__(None, None, None)  # the session ends, and its viewers with it
            assert await asyncio.to_thread(until, lambda: free(server) == 1)
        finally:
            for watcher in (one, two, three):
                await watcher.close()


async def test_viewers_are_drawn_by_the_renderer_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    class Grey(Renderer):
        def draw(self, surface: Surface) -> np.ndarray:
            return np.full_like(super().draw(surface), 100)

    monkeypatch.setitem(RENDERERS, "gpu", Grey)
    settings = dataclasses.replace(VIDEO, video_renderer="gpu")
    with serving(settings=settings, pipeline=Flasher()) as server, server.call(Hello(want=())):
        watcher = Watcher()
        try:
            await watch(server, watcher)
            assert await asyncio.to_thread(until, lambda: len(watcher.pictures) > 2)
        finally:
            await watcher.close()
    assert watcher.last is not None
    assert np.abs(watcher.last.astype(int) - 100).max() < 5


def test_a_server_whose_renderer_is_missing_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    settings = dataclasses.replace(VIDEO, video_renderer="gpu")
    with pytest.raises(DependencyError, match="echoavatar.gpu"), serving(settings=settings, pipeline=Flasher()):
        pass


async def test_a_viewer_that_vanishes_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aioice.ice, "CONSENT_INTERVAL", 0.1)
    with serving(settings=VIDEO, pipeline=Flasher()) as server, server.call(Hello(want=())):
        watcher = Watcher()
        await watch(server, watcher)
        await watcher.until(lambda: len(watcher.sounds) > 2)
        for transceiver in watcher.peer.getTransceivers():  # without a word, as when a cable is cut
            connection = transceiver.receiver.transport.transport._connection
            for protocol in connection._protocols:
                protocol.transport.close()
        assert await asyncio.to_thread(until, lambda: free(server) == 1, 20)
        await watcher.close()


async def test_a_viewer_that_never_connects_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    from echoavatar.server import whep

    monkeypatch.setattr(whep, "CONNECT_S", 0.3)
    with serving(settings=VIDEO, pipeline=Flasher()) as server, server.call(Hello(want=())):
        watcher = Watcher()
        offer = await watcher.offer()
        status, _, _ = await asyncio.to_thread(http, "POST", f"http://{server.address}/v1/whep", offer.encode())
        assert (status, free(server)) == (201, 0)
        assert await asyncio.to_thread(until, lambda: free(server) == 1)
        await watcher.close()


async def test_a_place_that_is_not_used_is_given_to_another_client_and_not_to_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from echoavatar.server import whep

    monkeypatch.setattr(whep, "GRACE_S", 0.2)
    settings = dataclasses.replace(VIDEO, proxies=("127.0.0.1",))
    with serving(settings=settings, pipeline=Flasher()) as server, server.call(Hello(want=())) as caller:
        watcher = Watcher()
        offer = (await watcher.offer()).encode()

        async def post(address: str) -> int:
            url = f"http://{server.address}/v1/sessions/{caller.ready.session}/whep"
            return (await asyncio.to_thread(http, "POST", url, offer, x_forwarded_for=address))[0]

        assert [await post("10.0.0.1"), await post("10.0.0.2")] == [201, 503]
        await asyncio.sleep(0.3)
        assert [await post("10.0.0.1"), await post("10.0.0.2"), await post("10.0.0.1")] == [503, 201, 503]
        await watcher.close()


async def test_an_address_that_holds_all_renderers_gives_one_up_to_another() -> None:
    settings = dataclasses.replace(VIDEO, video=3, proxies=("127.0.0.1",))
    with serving(settings=settings, pipeline=Flasher()) as server, server.call(Hello(want=())) as caller:
        path = f"/v1/sessions/{caller.ready.session}/whep"
        watchers = [Watcher() for _ in range(3)]
        try:
            for watcher in watchers:
                await watch(server, watcher, path, x_forwarded_for="10.0.0.1")
                await watcher.until(lambda watcher=watcher: len(watcher.sounds) > 2)

            async def post(address: str) -> int:
                other = Watcher()
                offer = (await other.offer()).encode()
                url = f"http://{server.address}{path}"
                status = (await asyncio.to_thread(http, "POST", url, offer, x_forwarded_for=address))[0]
                await other.close()
                return status

            assert await post("10.0.0.1") == 503  # its own share
            assert [await post("10.0.0.2"), await post("10.0.0.3")] == [201, 201]
            assert await post("10.0.0.4") == 503  # each has one
        finally:
            for watcher in watchers:
                await watcher.close()


async def test_a_client_that_posts_and_deletes_offers_in_a_loop_is_told_to_wait() -> None:
    rates = ClientRates(offers=Rate(2, 1))
    with (
        serving(settings=dataclasses.replace(VIDEO, rates=rates), pipeline=Flasher()) as server,
        server.call(Hello(want=())),
    ):
        watcher, base = Watcher(), f"http://{server.address}"
        offer = await watcher.offer()
        many = "".join(f"a=candidate:{n} 1 udp 7 name{n}.local {20_000 + n} typ host\r\n" for n in range(900))
        offer = offer.replace("a=candidate:", many + "a=candidate:", 1)
        for _ in range(2):
            began = time.monotonic()
            status, told, text = await asyncio.to_thread(http, "POST", f"{base}/v1/whep", offer.encode())
            assert status == 201, text
            assert time.monotonic() - began < 2.0
            assert (await asyncio.to_thread(http, "DELETE", base + told["location"]))[0] == 200
        status, told, text = await asyncio.to_thread(http, "POST", f"{base}/v1/whep", offer.encode())
        assert (status, 0 < int(told["retry-after"]) <= 60) == (429, True), text
        assert free(server) == 1
        await watcher.close()


async def test_what_cannot_be_answered_is_refused_in_one_line_and_takes_no_renderer() -> None:
    often = ClientRates(offers=Rate(100, 6_000))
    settings = dataclasses.replace(VIDEO, token="secret", lists_sessions=False, rates=often)
    with (
        serving(settings=settings, pipeline=Flasher()) as server,
        server.call(Hello(want=(), token="secret")) as caller,
    ):
        key = "Bearer secret"
        own = f"http://{server.address}/v1/sessions/{caller.ready.session}/whep"
        watcher = Watcher()
        offer = (await watcher.offer()).encode()
        sound_only = Watcher()
        sound = (await sound_only.offer("audio")).encode()

        async def asked(url: str, body: bytes, **more: str) -> tuple[int, str]:
            status, _, text = await asyncio.to_thread(http, "POST", url, body, **more)
            return status, text

        tried = {
            "no token": (await asked(own, offer), 401),
            "another page": (await asked(own, offer, authorization=key, origin="https://evil.example"), 403),
            "no such session": (await asked(own.replace(caller.ready.session, "x"), offer, authorization=key), 404),
            "a session unnamed": (await asked(f"http://{server.address}/v1/whep", offer, authorization=key), 404),
            "no SDP": (await asked(own, b"hello", authorization=key), 400),
            "broken SDP": (await asked(own, offer[:900], authorization=key), 400),
            "no name of a medium": (await asked(own, offer.replace(b"a=mid:0\r\n", b""), authorization=key), 400),
            "no video": (await asked(own, sound, authorization=key), 400),
            "another type": (await asked(own, offer, authorization=key, kind="text/plain"), 415),
            "no such view": (await asked(f"{own}?view=inside", offer, authorization=key), 400),
            "nobody": (await asked(f"{own}?character=nobody", offer, authorization=key), 400),
            "no such background": (await asked(f"{own}?background=hell", offer, authorization=key), 400),
            "much": (await asked(own, b"x" * 70_000, authorization=key), 400),
        }
        assert {name: got[0] for name, (got, _) in tried.items()} == {name: want for name, (_, want) in tried.items()}
        assert all("error" in text and len(text) < 300 for (_, text), _ in tried.values())
        assert free(server) == 1
        await watcher.close()
        await sound_only.close()


def test_pages_of_allowed_origins_may_ask_and_others_not() -> None:
    settings = dataclasses.replace(VIDEO, origins=("https://avatar.example.org",))
    with serving(settings=settings, pipeline=Flasher()) as server:

        def preflight(origin: str) -> int:
            asked = {"access_control_request_method": "POST", "access_control_request_headers": "content-type"}
            return http("OPTIONS", f"http://{server.address}/v1/whep", origin=origin, **asked)[0]

        assert (preflight("https://avatar.example.org"), preflight("https://evil.example")) == (200, 400)


def test_the_page_is_served_and_without_video_nothing_of_it() -> None:
    with serving(settings=VIDEO, pipeline=Flasher()) as server:
        status, text = server.http("/video")
        assert (status, "/video.js" in text) == (200, True)
        assert server.http("/video.js")[0] == 200
        assert "echoavatar_video_viewers" in server.http("/metrics")[1]
    with serving() as server:
        assert server.http("/v1/whep", b"x")[0] in (404, 405)
        assert "video" not in server.http("/health")[1]


def test_the_helpers_find_middles() -> None:
    times, share = np.arange(10.0), np.array([1, 0, 0, 1, 1, 1, 0, 0, 1, 1.0])
    assert [found.tolist() for found in runs(times, share)] == [[4.0], [0.5]]
    times[6:] += 2  # two pictures are missing
    assert [found.tolist() for found in runs(times, share)] == [[4.5], [1.0]]
