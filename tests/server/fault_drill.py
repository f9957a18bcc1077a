"""Faults in a running server with four sessions: who is lost, who goes on, and the longest wait for motion.

`python -m tests.server.fault_drill [BUNDLE]` prints a table. The seconds before each fault are measured, too: on a busy
machine sessions stand still without one.
"""

import asyncio
import multiprocessing
import os
import signal
import sys
import threading
import time
from typing import Any

from echoavatar import engine as engines
from echoavatar.engine import thread as engine_thread
from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, create_app, serve
from echoavatar_lab.bench.soak import Watcher, _Client

SESSIONS, WARM_S, WATCH_S, STUCK_S = 4, 8.0, 7.0, 3.0
HEALED = (
    *(
        f"out of memory once, in `{stage}`"
        for stage in ("level", "face", "codec", "generator", "decoder", "feet", "hands")
    ),
    "out of memory at every step, until loaded again",
    "an error of torch at every step, until loaded again",
    "a stage of session 1 alone fails",
    "poses of session 2 are not finite",
)
FATAL = (
    "three faults of the engine within a minute",
    f"a step that never ends (limit set to {STUCK_S:g} s)",
    "kill -9",
)


def served(model: str, orders: Any, told: Any) -> None:
    """The server's process: does what it is ordered to."""
    engine = engines.load(model, seats=SESSIONS)
    app = create_app(engine, ServerSettings(drain_seconds=0.5))
    threading.Thread(target=hurt, args=(engine, app.state.manager, orders), daemon=True).start()
    try:
        serve(app, port=0, on_ready=told.put)
    except EchoAvatarError as error:
        sys.exit(str(error))


def hurt(engine: engines.Engine, manager: Any, orders: Any) -> None:
    while True:
        order = orders.get()
        if order.startswith("out of memory once"):
            fail_at(engine.pipeline, order.split("`")[1], times=1, fault=MemoryError("injected"))
        elif "at every step" in order:
            fault = RuntimeError("injected: CUDA error") if "torch" in order else MemoryError("injected")
            fail_at(engine.pipeline, "level", times=1_000_000, fault=fault)
        elif order.startswith("three"):
            for _ in range(3):
                restarts = engine.restarts
                fail_at(engine.pipeline, "level", times=1_000_000, fault=MemoryError("injected"))
                while engine.restarts == restarts and manager.failure is None:
                    time.sleep(0.05)
        elif "never ends" in order:
            engine_thread.STUCK_S = STUCK_S
            engine.pipeline.on_stage = lambda _: time.sleep(1_000)
        elif "session 1" in order:
            core(manager, 1)._gaze = None
        elif "session 2" in order:
            victim = core(manager, 2)
            row = engine._rows.of([victim.seat])
            for part in row.arrays():
                if part.dtype.kind == "f":
                    part[:] = float("nan")
        elif order == "kill -9":
            os.kill(os.getpid(), signal.SIGKILL)


def core(manager: Any, seed: int) -> Any:
    return next(known for known in (manager.find(name).core for name in manager.names) if known.seed == seed)


def fail_at(pipeline: Any, at: str, *, times: int, fault: Exception) -> None:
    healthy, left = pipeline.on_stage, [times]

    def fail(stage: str) -> None:
        if stage == at:
            left[0] -= 1
            if left[0] <= 0:
                pipeline.on_stage = healthy
            raise fault

    pipeline.on_stage = fail


async def drill(model: str, faults: tuple[str, ...]) -> None:
    """One server, four sessions that speak, and faults one after the other."""
    context = multiprocessing.get_context("spawn")
    orders, told = context.Queue(), context.Queue()
    process = context.Process(target=served, args=(model, orders, told), daemon=True)
    process.start()
    url = (await asyncio.to_thread(told.get, True, 300)).replace("http", "ws", 1) + "/v1/stream"
    clients = [_Client(url, number, is_well=True) for number in range(SESSIONS)]
    tasks = [asyncio.create_task(client.run()) for client in clients]
    await asyncio.sleep(WARM_S)
    for fault in faults:
        watchers = [client.watcher for client in clients]
        longest_waits(watchers)
        await asyncio.sleep(WATCH_S)
        before, counts = longest_waits(watchers), [+watcher.counts for watcher in watchers]
        orders.put(fault)
        await asyncio.sleep(WATCH_S)
        show(fault, watchers, counts, before, process)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    process.terminate()
    process.join(20)


def longest_waits(watchers: list[Watcher]) -> list[float]:
    """The longest wait of each since the last call, one that is not over included."""
    now = time.monotonic()
    waits = [max(watcher.stillness_s, now - min(now, watcher._heard_at)) for watcher in watchers]
    for watcher in watchers:
        watcher.stillness_s = 0.0
    return waits


def show(fault: str, watchers: list[Watcher], counts: list[Any], before: list[float], process: Any) -> None:
    still = longest_waits(watchers)
    process.join(60 if fault in FATAL else 0)
    new = [watcher.counts - then for watcher, then in zip(watchers, counts, strict=True)]
    is_over = process.exitcode is not None
    lost = [number for number, counts in enumerate(new) if is_over or counts["lost"]]
    wrong = sum(counts[name] for counts in new for name in ("stale", "doubled", "missing"))
    after = [f"{seconds:.1f}" for number, seconds in enumerate(still) if number not in lost]
    end = f"the process ended with status {process.exitcode}" if is_over else ""
    going = SESSIONS - len(lost)
    lost_now, then = ", ".join(map(str, lost)) or "none", " ".join(f"{seconds:.1f}" for seconds in before)
    row = (fault, lost_now, str(going), then, " ".join(after) or "-", str(wrong), end)
    sys.stdout.write(f"| {' | '.join(row)} |\n")
    sys.stdout.flush()


def main() -> None:
    model = sys.argv[1] if len(sys.argv) > 1 else "default"
    columns = ("fault", "lost", "went on", "waits before it, s", "waits after it, s", "stale, doubled, missing", "")
    sys.stdout.write(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}\n")
    asyncio.run(drill(model, HEALED[:-4]))
    for fault in HEALED[-4:]:  # by themselves, because three faults of the engine within a minute end it
        asyncio.run(drill(model, (fault,)))
    for fault in FATAL:
        asyncio.run(drill(model, (fault,)))


if __name__ == "__main__":
    main()
