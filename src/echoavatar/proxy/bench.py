"""`echoavatar bench proxy`: what the avatar adds to the way of the voice, beside a plain relay, in one run.

One scripted upstream says the same sound on three ways at nearly the same time: straight to the client, through a
plain relay, and through the proxy with an avatar that moves to it. Upstream, relay and proxy are processes of their
own, as they would be; every event carries the moment it was sent, and the ways take turns in who is first.
"""

import asyncio
import json
import multiprocessing
import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
from websockets.asyncio.client import connect

from ..timing import SAMPLE_RATE_HZ
from .relay import Relay
from .scripted import Part, ScriptedUpstream
from .settings import ProxySettings
from .upstream import quiet_logger

WAYS = ("direct", "relay", "proxy")
DELTA_S = 0.04
ITEM_S = 8.0
APART_S = 0.004  # between the ways, so that one does not wait for the other in the client
WARM_UP_S = 3.0
_STAMP = re.compile(r'"event_id": "at_(\d+)"')


class Way(NamedTuple):
    """How long events took on one way, in milliseconds."""

    p50: float
    p95: float
    p99: float
    most: float
    events: int


class ProxyReport(NamedTuple):
    """All ways, and how much of the avatar came beside the voice."""

    ways: dict[str, Way]
    frames: int  # of motion of what was said
    expected_frames: int

    @property
    def added_p99_ms(self) -> float:
        """The proxy's 99th percentile over the plain relay's."""
        return self.ways["proxy"].p99 - self.ways["relay"].p99

    @property
    def summary(self) -> dict[str, float]:
        """For one line of JSON."""
        facts = {
            f"{name}_{key}_ms": round(getattr(way, key), 3)
            for name, way in self.ways.items()
            for key in ("p50", "p99")
        }
        return facts | {
            "added_p50_ms": round(self.ways["proxy"].p50 - self.ways["relay"].p50, 3),
            "added_p99_ms": round(self.added_p99_ms, 3),
            "events": self.ways["proxy"].events,
            "frames": self.frames,
            "expected_frames": self.expected_frames,
        }


def bench_proxy(avatar: str, *, seconds: float = 60.0) -> ProxyReport:
    """Run it; `avatar` is the address of a server."""
    spawn = multiprocessing.get_context("spawn")
    with ExitStack() as stack:

        def begin(target: Callable[..., None], *given: object) -> int:
            near, far = spawn.Pipe()
            process = spawn.Process(target=target, args=(far, *given), daemon=True)
            process.start()
            stack.callback(process.join, 5)
            stack.callback(process.terminate)
            return int(near.recv())

        upstream = f"ws://127.0.0.1:{begin(_upstream, seconds)}/v1/realtime"
        relay = begin(_relay, upstream, "")
        proxy = begin(_relay, upstream, avatar)
        urls = [upstream] + [f"ws://127.0.0.1:{port}/v1/realtime" for port in (relay, proxy)]
        return asyncio.run(_listen(urls, seconds))


async def _listen(urls: list[str], seconds: float) -> ProxyReport:
    took: dict[str, list[float]] = {way: [] for way in WAYS}
    frames = 0

    async def one(way: str, url: str) -> None:
        nonlocal frames
        async with connect(url, compression=None, max_size=None, logger=quiet_logger()) as line:
            await line.send(json.dumps({"type": "way", "way": way}))
            async for message in line:
                now = time.perf_counter_ns()
                assert isinstance(message, str)
                stamp = _STAMP.search(message, 0, 120)
                if stamp:
                    took[way].append((now - int(stamp[1])) / 1e6)
                elif '"response.animation_blendshapes.delta"' in message[:60]:
                    frames += len(json.loads(message)["frames"])
                elif '"bye"' in message[:40]:
                    return

    await asyncio.gather(*(one(way, url) for way, url in zip(WAYS, urls, strict=True)))
    skipped = round(WARM_UP_S / DELTA_S)
    ways = {}
    for way, times in took.items():
        p50, p95, p99 = np.percentile(times[skipped:], (50, 95, 99))
        ways[way] = Way(float(p50), float(p95), float(p99), max(times[skipped:]), len(times))
    return ProxyReport(ways, frames, round(seconds * 30))


# ---- processes of their own


def _upstream(told: Connection, seconds: float) -> None:
    asyncio.run(_serve_upstream(told, seconds))


async def _serve_upstream(told: Connection, seconds: float) -> None:
    parts: dict[str, Part] = {}
    all_there = asyncio.Event()
    is_over = asyncio.Event()

    async def script(part: Part) -> None:
        parts[(await part.until("way"))["way"]] = part
        if len(parts) == len(WAYS):
            all_there.set()
        await is_over.wait()
        await part.send("bye")

    async with ScriptedUpstream(script) as upstream:
        told.send(int(upstream.url.split(":")[2].split("/")[0]))
        await all_there.wait()
        await asyncio.sleep(WARM_UP_S)  # the avatar's session begins
        await _say([parts[way] for way in WAYS], seconds)
        await asyncio.sleep(2.0)
        is_over.set()
        await asyncio.sleep(1.0)


async def _say(parts: list[Part], seconds: float) -> None:
    """Syllables of noise, at the pace they are heard, to each way in turn."""
    import base64

    rng = np.random.default_rng(0)
    size = round(DELTA_S * SAMPLE_RATE_HZ)
    begun = time.perf_counter()
    for number in range(round(seconds / DELTA_S)):
        item, at = divmod(number, round(ITEM_S / DELTA_S))
        loud = 6_000 * abs(np.sin(number * DELTA_S * np.pi * 4))
        delta = base64.b64encode(rng.normal(0, loud, size).astype("<i2").tobytes()).decode()
        place = {
            "item_id": f"item_{item}",
            "response_id": f"resp_{item}",
            "output_index": 0,
            "content_index": 0,
        }
        for turn in range(len(parts)):
            part = parts[(number + turn) % len(parts)]
            event = {
                "event_id": f"at_{time.perf_counter_ns()}",
                "type": "response.output_audio.delta",
                **place,
            }
            await part.line.send(json.dumps({**event, "delta": delta}))
            if at == round(ITEM_S / DELTA_S) - 1:
                await part.line.send(json.dumps({"type": "response.output_audio.done", **place}))
            await asyncio.sleep(APART_S)
        await asyncio.sleep(max(0.0, begun + (number + 1) * DELTA_S - time.perf_counter()))


def _relay(told: Connection, upstream: str, avatar: str) -> None:
    async def serve() -> None:
        told.send(await Relay(ProxySettings(upstream, avatar=avatar)).start(port=0))
        await asyncio.Event().wait()

    asyncio.run(serve())
