"""`echoavatar bench soak`: a server in a process of its own under load, and whether its sessions stay whole.

Each session speaks in real time and checks what it receives: sound and motion are contiguous, nothing comes twice,
nothing is stale. It speaks again when it was heard, as a person does: else speech would gather on a machine that is too
slow. Visitors come, speak and leave again and again. With faults, session 0 remains a witness, and the
others lose the connection, stall, flood, interrupt and vanish. Once a minute the server itself is hurt: the pipeline
breaks until it is loaded again, or a stage runs out of memory once, or a session fails.
"""

import asyncio
import itertools
import multiprocessing
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from math import inf
from pathlib import Path
from statistics import linear_regression
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from echoavatar import engine as engines
from echoavatar import outgoing
from echoavatar.agents.client.connection import open_websocket
from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, create_app, serve
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.codec import decode_server, encode, subprotocol
from echoavatar.wire.messages import (
    Audio,
    End,
    Error,
    Flush,
    Hello,
    Interrupt,
    Motion,
    Ready,
    ServerMessage,
    Sound,
    State,
)
from echoavatar_lab.training.curves import save_figure

START_S = 300.0  # for the server to load, and to compile on a new machine
FAULT_S = 60.0  # between faults of the server
TROUBLE_S = 12.0  # between faults of a client, on average
STALL_S = 4.0
PATIENCE_S = 30.0  # for an utterance to be heard
LOOK_S = 5.0  # between looks at the memory
PIECE_S, UTTERANCE = 0.1, 25  # length of a message of speech, and how many make an utterance
FLOOD_S = 150  # more than the server keeps
VISIT = 6_400 * 4  # samples that a visitor watches
TROUBLES = ("drop", "stall", "flood", "interrupt", "vanish")


class Watcher:
    """Counts the messages of one session and checks them against its clock and epoch."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.stillness_s = 0.0  # longest wait for motion
        self.finished = 0  # the newest utterance that is over
        self.key, self.next = "", 0  # to resume with: the session's key, the clock of the next sound
        self.epoch = 0
        self._motion, self._heard_at = 0, inf

    def see(self, message: ServerMessage | None) -> None:
        """Count a message."""
        if isinstance(message, Ready):
            if message.resumed:  # whole chunks are sent again, from `at` on, also motion whose sound was lost
                self.next, self._motion = min(self.next, message.at), min(self._motion, message.at)
            else:
                self.counts["begun"] += 1
                self.next = self._motion = message.at
            self.counts["resumed"] += message.resumed
            self.key, self.epoch, self._heard_at = message.resume, message.epoch, inf
        elif isinstance(message, Flush):
            self.epoch, self.next = message.epoch, min(self.next, message.at)
            self._motion = min(self._motion, message.at)
        elif isinstance(message, Sound):
            self.counts["doubled"] += message.at < self.next
            self.counts["missing"] += message.at > self.next
            self.counts["stale"] += message.epoch < self.epoch
            self.next = message.at + len(message.pcm) // 2
        elif isinstance(message, Motion):
            self.counts["frames"] += message.frames
            self.counts["doubled"] += message.at < self._motion
            self.counts["dropped"] += max(0, message.at - self._motion) // SAMPLES_PER_FRAME  # a slow reader's
            self.counts["stale"] += message.epoch < self.epoch
            self._motion = message.at + message.frames * SAMPLES_PER_FRAME
            self.stillness_s = max(self.stillness_s, time.monotonic() - self._heard_at)
            self._heard_at = time.monotonic()
        elif isinstance(message, State):
            self.finished = message.finished
        elif isinstance(message, Error):
            self.counts["told " + message.code] += 1
            self.counts["lost"] += message.fatal and message.code in ("internal", "unknown_session")
            if message.fatal:
                self.key = ""


class _Client:
    """A session that speaks until it is told to stop, and comes back when the connection breaks."""

    def __init__(self, url: str, number: int, *, is_well: bool) -> None:
        self.watcher = Watcher()
        self._url, self._number, self._is_well = url, number, is_well
        self._random, self._seg, self._stalls_until = random.Random(number), 0, 0.0
        self._sound = 0.1 * np.random.default_rng(number).standard_normal(SAMPLE_RATE_HZ).astype(np.float32)

    async def run(self) -> None:
        while True:
            with suppress(ConnectionClosed, OSError, TimeoutError, InvalidHandshake):
                async with await _dial(self._url) as socket:
                    await self._live(socket)
            await asyncio.sleep(0.2)

    async def _live(self, socket: ClientConnection) -> None:
        watcher = self.watcher
        hello = Hello(seed=self._number, resume=watcher.key, played=watcher.next, epoch=watcher.epoch)
        await socket.send(encode(hello))
        watcher.see(decode_server(await socket.recv(decode=False)))  # the answer, before anything else is sent
        tasks = [asyncio.create_task(self._speak(socket))]
        if not self._is_well:
            tasks.append(asyncio.create_task(self._make_trouble(socket)))
        try:
            while True:
                await asyncio.sleep(self._stalls_until - time.monotonic())
                watcher.see(decode_server(await socket.recv(decode=False)))
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _speak(self, socket: ClientConnection) -> None:
        piece = round(PIECE_S * SAMPLE_RATE_HZ)
        while True:
            self._seg += 1
            seg = self._seg
            for index in range(UTTERANCE):
                if seg != self._seg:  # interrupted
                    break
                await socket.send(encode(Audio(seg=seg, start=index * piece, pcm=pack_audio(self._sound[:piece]))))
                await asyncio.sleep(PIECE_S)
            await socket.send(encode(End(seg=seg)))
            for _ in range(round(PATIENCE_S / PIECE_S)):
                if self.watcher.finished >= seg or seg != self._seg:
                    break
                await asyncio.sleep(PIECE_S)
            await asyncio.sleep(1.0)

    async def _make_trouble(self, socket: ClientConnection) -> None:
        while True:
            await asyncio.sleep(2 * TROUBLE_S * self._random.random())
            trouble = self._random.choice(TROUBLES)
            self.watcher.counts[trouble] += 1
            if trouble == "stall":
                self._stalls_until = time.monotonic() + STALL_S
            elif trouble in ("drop", "vanish"):
                self.watcher.key = self.watcher.key if trouble == "drop" else ""
                socket.transport.abort()
            else:
                self._seg += 1
                for second in range(FLOOD_S if trouble == "flood" else 0):
                    pcm = pack_audio(self._sound)
                    await socket.send(encode(Audio(seg=self._seg, start=second * SAMPLE_RATE_HZ, pcm=pcm)))
                await socket.send(encode(Interrupt(seg=self._seg)))


async def _visit(url: str, seen: Counter[str], number: int) -> None:
    """Come, speak, watch and leave, again and again."""
    for turn in itertools.count(1000 * number):
        watcher = Watcher()
        with suppress(ConnectionClosed, OSError, TimeoutError, InvalidHandshake):
            async with await _dial(url) as socket:
                await socket.send(encode(Hello(seed=1000 + turn)))
                await socket.send(encode(Audio(seg=1, start=0, pcm=pack_audio(np.full(SAMPLE_RATE_HZ, 0.1)))))
                while watcher.next < VISIT:
                    watcher.see(decode_server(await socket.recv(decode=False)))
                seen["turns"] += 1
        seen.update({name: watcher.counts[name] for name in ("stale", "doubled", "missing", "lost", "frames")})
        await asyncio.sleep(0.1)


async def _dial(url: str) -> ClientConnection:
    return await open_websocket(url, subprotocols=[subprotocol("msgpack")], open_timeout=30)


async def _soak(
    url: str, clients: list[_Client], visitors: int, seen: Counter[str], seconds: float, look: Callable[[float], None]
) -> None:
    tasks = [asyncio.create_task(client.run()) for client in clients]
    tasks += [asyncio.create_task(_visit(url, seen, number)) for number in range(1, visitors + 1)]
    began = time.monotonic()
    while (past := time.monotonic() - began) < seconds:
        look(past)
        done = [task for task in tasks if task.done()]
        if done:
            await done[0]  # raises what ended it
        await asyncio.sleep(min(LOOK_S, max(0.0, seconds - past)))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def bench_soak(
    model: str,
    *,
    sessions: int = 4,
    visitors: int = 1,
    minutes: float = 1.0,
    faults: bool = False,
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Run the soak. `progress` is told the minutes that have passed.

    The report is counts, the share of real time that the sessions' motion reached, and memory over time in MB. Raises
    EchoAvatarError if the server did not start, or ended.
    """
    context = multiprocessing.get_context("spawn")
    told = context.Queue()
    process = context.Process(target=_serve, args=(model, sessions + 2 * visitors, faults, told), daemon=True)
    process.start()
    try:
        address = _await_address(process, told)
        url = address.replace("http", "ws", 1) + "/v1/stream"
        clients = [_Client(url, number, is_well=not faults or number == 0) for number in range(sessions)]
        seen: Counter[str] = Counter()
        memory: list[tuple[float, float]] = []

        def look(seconds: float) -> None:
            if not process.is_alive():
                raise EchoAvatarError(f"the server ended with status {process.exitcode}; see its last lines above")
            memory.append((seconds, _resident_mb(process.pid)))
            progress(seconds / 60)

        asyncio.run(_soak(url, clients, visitors, seen, 60 * minutes, look))
        metrics = outgoing.fetch(f"{address}/metrics").decode()
    finally:
        process.terminate()
        process.join(20)
    counts = sum((client.watcher.counts for client in clients), Counter[str]())
    real_time = counts["frames"] / (FRAME_RATE_HZ * 60 * minutes * max(1, sessions))
    counts += seen
    late = [(seconds, mb) for seconds, mb in memory if seconds >= memory[-1][0] / 3]
    slope = 3600 * linear_regression(*zip(*late, strict=True)).slope if len(late) > 2 else 0.0
    return {
        **{name: counts[name] for name in ("frames", "stale", "doubled", "missing", "lost", "resumed", "dropped")},
        "failed_by_us": int(_metric(metrics, "echoavatar_session_faults_total")),
        "restarts": int(_metric(metrics, "echoavatar_engine_restarts_total")),
        "turns": counts["turns"],
        "troubles": {name: counts[name] for name in TROUBLES},
        "told": {name[5:]: count for name, count in counts.items() if name.startswith("told ")},
        "stillness_s": round(clients[0].watcher.stillness_s, 2) if clients else 0.0,
        "real_time": round(real_time, 2),
        "slope_mb_an_hour": round(slope, 1),
        "memory_mb": [(round(seconds), round(mb, 1)) for seconds, mb in memory[:: max(1, len(memory) // 120)]],
    }


def _await_address(process: Any, told: Any) -> str:
    end = time.monotonic() + START_S
    while process.is_alive() and time.monotonic() < end:
        with suppress(Exception):
            return str(told.get(timeout=0.5))
    raise EchoAvatarError("the server did not start; try `echoavatar serve`")


def _resident_mb(pid: int | None) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _metric(text: str, name: str) -> float:
    return next((float(line.split()[1]) for line in text.splitlines() if line.startswith(name + " ")), 0.0)


# ---- a picture: resident memory over time, and the line through its last two thirds


def draw(report: Mapping[str, Any], path: Path) -> None:
    """Write the memory of a soak over time. Raises EchoAvatarError if the picture cannot be written."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axis = figure.subplots()
    seconds, memory = np.array(report["memory_mb"], np.float64).T
    (curve,) = axis.plot(seconds / 60, memory, lw=1.2)
    late = seconds >= seconds[-1] / 3
    slope = float(report["slope_mb_an_hour"])
    level = memory[late].mean() + slope * (seconds[late] - seconds[late].mean()) / 3600
    told = f"{slope:+.1f} MB an hour, {report['turns']} visits"
    axis.plot(seconds[late] / 60, level, "--", lw=1, color=curve.get_color(), label=told)
    axis.set(xlabel="minutes", ylabel="resident memory (MB)", ylim=(0, 1.1 * axis.get_ylim()[1]))
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right", fontsize=8)
    save_figure(figure, path)


# ---- in the server's process


def _serve(model: str, seats: int, faults: bool, told: Any) -> None:
    engine = engines.load(model, seats=seats)
    app = create_app(engine, ServerSettings(drain_seconds=0.5))
    if faults:
        threading.Thread(target=_hurt, args=(engine, app.state.manager), daemon=True).start()
    serve(app, port=0, on_ready=told.put)


def _hurt(engine: engines.Engine, manager: Any) -> None:
    """Hurt the engine, a step, or any session but the witness, once a minute."""
    chance = random.Random(0)
    for kind in itertools.cycle(("engine", "step", "session")):
        time.sleep(FAULT_S)
        if kind == "session":
            cores = [manager.find(name).core for name in manager.names]
            chance.choice([core for core in cores if core.seed > 0]).fail(MemoryError("injected"))
        else:
            _break(engine, chance.choice(("level", "codec", "generator", "decoder")), for_good=kind == "engine")


def _break(engine: engines.Engine, at: str, *, for_good: bool) -> None:
    """Let a stage fail: once, or at every step until the pipeline is loaded again."""
    healthy = engine.pipeline.on_stage

    def fail(stage: str) -> None:  # holds the engine: if it held the pipeline, that would stay in memory
        if stage == at:
            if not for_good:
                engine.pipeline.on_stage = healthy
            raise MemoryError(f"injected behind {stage}")

    engine.pipeline.on_stage = fail
