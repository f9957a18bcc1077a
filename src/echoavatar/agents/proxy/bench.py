"""`echoavatar bench proxy`: the delay that the avatar adds to the voice, compared with a plain relay in the same run.

One upstream sends the same speech over three routes at nearly the same time: straight to the client, through a plain
relay, and through the proxy with an avatar. Upstream, relay and proxy run in processes of their own. Every event
carries the time it was sent, and the routes take turns in going first.
"""

import asyncio
import base64
import json
import multiprocessing
import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
from websockets.asyncio.server import ServerConnection

from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.sockets import serve_websockets

from ..client.connection import open_websocket, quiet_logger
from .relay import Relay
from .upstream import ProxySettings

ROUTES = ("direct", "relay", "proxy")
DELTA_S = 0.04
ITEM_S = 8.0
APART_S = 0.004  # between the routes, so that no event waits for another one in the client
WARM_UP_S = 3.0
_STAMP = re.compile(r'"event_id": "at_(\d+)"')


class Route(NamedTuple):
    """How long events took one route, in milliseconds."""

    p50: float
    p95: float
    p99: float
    most: float
    events: int


class ProxyReport(NamedTuple):
    """The delays of all routes, and how much motion arrived beside the voice."""

    routes: dict[str, Route]
    frames: int  # of motion that arrived for the speech
    expected_frames: int

    @property
    def added_p99_ms(self) -> float:
        """The proxy's 99th percentile minus the relay's."""
        return self.routes["proxy"].p99 - self.routes["relay"].p99

    @property
    def summary(self) -> dict[str, float]:
        """The numbers for one line of JSON."""
        facts = {
            f"{name}_{key}_ms": round(getattr(route, key), 3)
            for name, route in self.routes.items()
            for key in ("p50", "p99")
        }
        return facts | {
            "added_p50_ms": round(self.routes["proxy"].p50 - self.routes["relay"].p50, 3),
            "added_p99_ms": round(self.added_p99_ms, 3),
            "events": self.routes["proxy"].events,
            "frames": self.frames,
            "expected_frames": self.expected_frames,
        }


def bench_proxy(avatar: str, *, seconds: float = 60.0) -> ProxyReport:
    """Run the benchmark; `avatar` is the address of a server."""
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
    took: dict[str, list[float]] = {route: [] for route in ROUTES}
    frames = 0

    async def one(route: str, url: str) -> None:
        nonlocal frames
        async with await open_websocket(url, max_size=None) as websocket:
            await websocket.send(json.dumps({"type": "route", "route": route}))
            async for message in websocket:
                now = time.perf_counter_ns()
                assert isinstance(message, str)
                stamp = _STAMP.search(message, 0, 120)
                if stamp:
                    took[route].append((now - int(stamp[1])) / 1e6)
                elif '"response.animation_blendshapes.delta"' in message[:60]:
                    frames += len(json.loads(message)["frames"])
                elif '"bye"' in message[:40]:
                    return

    await asyncio.gather(*(one(route, url) for route, url in zip(ROUTES, urls, strict=True)))
    skipped = round(WARM_UP_S / DELTA_S)
    routes = {}
    for route, times in took.items():
        p50, p95, p99 = np.percentile(times[skipped:], (50, 95, 99))
        routes[route] = Route(float(p50), float(p95), float(p99), max(times[skipped:]), len(times))
    return ProxyReport(routes, frames, round(seconds * 30))


# ---- what runs in processes of its own


def _upstream(pipe: Connection, seconds: float) -> None:
    asyncio.run(_serve_upstream(pipe, seconds))


async def _serve_upstream(pipe: Connection, seconds: float) -> None:
    websockets: dict[str, ServerConnection] = {}  # by route
    all_there, is_over = asyncio.Event(), asyncio.Event()

    async def play(websocket: ServerConnection) -> None:
        await websocket.send(json.dumps({"type": "session.created"}))  # the avatar's session waits for it
        websockets[json.loads(await websocket.recv())["route"]] = websocket
        if len(websockets) == len(ROUTES):
            all_there.set()
        await is_over.wait()
        await websocket.send(json.dumps({"type": "bye"}))

    quiet = quiet_logger()
    async with await serve_websockets(play, "127.0.0.1", 0, compression=None, max_size=None, logger=quiet) as server:
        pipe.send(int(next(iter(server.sockets)).getsockname()[1]))
        await all_there.wait()
        await asyncio.sleep(WARM_UP_S)  # time for the avatar's session to start
        await _say([websockets[route] for route in ROUTES], seconds)
        await asyncio.sleep(2.0)
        is_over.set()
        await asyncio.sleep(1.0)


async def _say(websockets: list[ServerConnection], seconds: float) -> None:
    """Send syllables of noise at the pace of playback, each route in turn."""
    rng = np.random.default_rng(0)
    size = round(DELTA_S * SAMPLE_RATE_HZ)
    begun = time.perf_counter()
    for number in range(round(seconds / DELTA_S)):
        item, at = divmod(number, round(ITEM_S / DELTA_S))
        loud = 6_000 * abs(np.sin(number * DELTA_S * np.pi * 4))
        delta = base64.b64encode(rng.normal(0, loud, size).astype("<i2").tobytes()).decode()
        address = {"item_id": f"item_{item}", "response_id": f"resp_{item}", "output_index": 0, "content_index": 0}
        for offset in range(len(websockets)):
            websocket = websockets[(number + offset) % len(websockets)]
            event = {"event_id": f"at_{time.perf_counter_ns()}", "type": "response.output_audio.delta", **address}
            await websocket.send(json.dumps({**event, "delta": delta}))
            if at == round(ITEM_S / DELTA_S) - 1:
                await websocket.send(json.dumps({"type": "response.output_audio.done", **address}))
            await asyncio.sleep(APART_S)
        await asyncio.sleep(max(0.0, begun + (number + 1) * DELTA_S - time.perf_counter()))


def _relay(pipe: Connection, upstream: str, avatar: str) -> None:
    async def serve() -> None:
        pipe.send(await Relay(ProxySettings(upstream, avatar=avatar)).start(port=0))
        await asyncio.Event().wait()

    asyncio.run(serve())
