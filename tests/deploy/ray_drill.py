"""Two replicas, two clients, one replica killed: its client must continue at the other. Prints one line of JSON.

With a number of minutes: a soak of four clients, and once a minute the replica of the first of them is killed.

A program of its own, because Ray wants the process for itself; `test_ray_serve.py` runs it.
"""

import asyncio
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import ray
from deploy.ray_serve import Avatars, Options, deployment
from ray import serve

from echoavatar.agents.client import Recorder, connect
from echoavatar.errors import EchoAvatarError
from echoavatar.wire.messages import Sound

ROOT = Path(__file__).parents[2]
PORT = 18_765
SECONDS = 14.0
SEATS = 4  # a replica has room for all while the other one starts


class Doubles(Avatars):
    """Replicas with a fake body."""

    def __serve_build_asgi_app__(self) -> object:  # noqa: N807
        from tests.server.fakes import Body

        from echoavatar.engine import Engine
        from echoavatar.server import ServerSettings, create_app

        name = serve.get_replica_context().replica_id.unique_id
        app = create_app(Engine(Body(0.02), seats=SEATS), ServerSettings(name=name))
        self._manager = app.state.manager
        return app


async def speak(hosts: list[str], number: int) -> dict[str, Any]:
    """Speak an utterance at playback speed, and measure for how long a player would have run out of sound."""
    async with connect(f"http://127.0.0.1:{PORT}") as avatar:
        hosts.append(avatar.ready.server.split()[-1])
        recorder = Recorder(avatar.ready)
        seg = await avatar.speak(np.full(round(SECONDS * 24_000), 0.25, np.float32))
        begun, dry, moved, last_end = 0.0, 0.0, 0, 0.0
        async for message in avatar:
            recorder.take(message)
            if avatar.ready.server.split()[-1] != hosts[number]:
                moved, hosts[number] = moved + 1, avatar.ready.server.split()[-1]
            if isinstance(message, Sound):
                begun = begun or time.monotonic()
                played = time.monotonic() - begun
                dry = max(dry, played - last_end if last_end else 0.0)
                last_end = recorder.end / 24_000
            if recorder.has(seg):
                break
        audio = recorder.recording(seg).audio
        return {"moved": moved, "dry_s": round(dry, 3), "spoken_s": np.count_nonzero(audio) / 24_000}


async def drill() -> dict[str, object]:
    hosts: list[str] = []
    first = asyncio.create_task(speak(hosts, 0))
    await asyncio.sleep(1)
    second = asyncio.create_task(speak(hosts, 1))
    await asyncio.sleep(4)
    killed = kill(hosts[0])
    results = await asyncio.wait_for(asyncio.gather(first, second), 60)
    return {"victim": results[0], "other": results[1], "same_host": hosts[1] == killed}


def kill(host: str) -> str:
    actors = ray.util.list_named_actors(all_namespaces=True)
    victim = next(a for a in actors if "REPLICA" in a["name"] and host in a["name"])
    ray.kill(ray.get_actor(victim["name"], namespace=victim["namespace"]))
    return host


async def soak(minutes: float) -> dict[str, object]:
    """Four people speak one utterance after the other; every minute the first one's replica dies."""
    end, told = time.monotonic() + 60 * minutes, []
    hosts: dict[int, list[str]] = {}

    async def talk(person: int) -> None:
        await asyncio.sleep(person)
        while time.monotonic() < end:
            hosts[person] = []
            try:
                told.append(await asyncio.wait_for(speak(hosts[person], 0), 60))
            except (OSError, TimeoutError, EchoAvatarError) as error:
                told.append({"failed": repr(error)})
                await asyncio.sleep(1)

    async def strike() -> int:
        kills = 0
        while time.monotonic() < end - 60:
            await asyncio.sleep(60)
            if hosts[0]:
                kills += bool(kill(hosts[0][0]))
        return kills

    kills, *_ = await asyncio.gather(strike(), *(talk(person) for person in range(4)))
    whole = [row for row in told if "failed" not in row]
    return {
        "kills": kills,
        "utterances": len(told),
        "failed": [row["failed"] for row in told if "failed" in row],
        "cut": [row["spoken_s"] for row in whole if abs(row["spoken_s"] - SECONDS) > 0.3],
        "moved": sum(row["moved"] for row in whole),
        "dry_s": max(row["dry_s"] for row in whole),
    }


def main() -> None:
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        object_store_memory=100 * 2**20,
        runtime_env={
            "env_vars": {key: value for key, value in os.environ.items() if key.startswith("RAY_SERVE_")}
            | {"PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}", "OMP_NUM_THREADS": "1"}
        },
    )
    serve.start(http_options={"host": "127.0.0.1", "port": PORT})
    options = Options(seats=SEATS, fewest=2, most=2, cpus=0.5)
    serve.run(deployment(Doubles, options).bind("", SEATS), route_prefix="/")
    print(json.dumps(asyncio.run(soak(float(sys.argv[1])) if sys.argv[1:] else drill())))  # noqa: T201
    serve.shutdown()
    ray.shutdown()


if __name__ == "__main__":
    main()
