"""`echoavatar bench neighbours`: how late is the avatar of an honest speaker while one other client misbehaves.

The speaker sends speech in real time and notes when each chunk of sound and motion arrives. Its clock is set in a quiet
start: from then on a chunk is due when the chunks before it have been played. Each neighbour misbehaves from a process
of its own, at the lowest priority, because on another machine it would cost the server no processor time.
"""

import asyncio
import multiprocessing
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from echoavatar.agents.client import connect
from echoavatar.cli.options import TOKEN
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import Motion, Sound
from echoavatar.wire.sockets import listen as listen_here

from .hostile_clients import NEIGHBOURS, WITH_TLS, WITH_VIDEO, Target, attack, make_offer, viewers_of

BAR_S = 0.3  # lateness of the worst chunk
START_S = 300.0  # for the server to load
QUIET_S = 4.0  # before the neighbour comes
PIECE_S, LEAD_S = 0.1, 0.5  # length of a message of speech; speech that is sent at once


# ---- the speaker


@dataclass
class Arrivals:
    """When the chunks of one kind came."""

    by_clock: dict[int, float] = field(default_factory=dict)  # seconds, by the first sample

    def lateness(self, since: float, until: float, chunk: int) -> tuple[list[float], int]:
        """Seconds that each chunk due between two moments came late, and how many came at all.

        A chunk that did not come counts as late until the end.
        """
        starts = [then - at / SAMPLE_RATE_HZ for at, then in self.by_clock.items() if then < since]
        if not starts:
            raise EchoAvatarError("nothing came from the server in the quiet start; it is too slow for one session")
        begun = median(starts)
        first = -(-round((since - begun) * SAMPLE_RATE_HZ) // chunk)
        last = round((until - begun) * SAMPLE_RATE_HZ) // chunk
        late, got = [], 0
        for at in range(first * chunk, last * chunk, chunk):
            due, then = begun + at / SAMPLE_RATE_HZ, self.by_clock.get(at)
            got += then is not None
            late.append(max(0.0, (until if then is None else then) - due))
        return late, got


async def listen(target: Target, seconds: float, begin: Callable[[str], Any]) -> dict[str, Any]:
    """Speak for so long beside a neighbour, whom `begin` starts after the quiet start; returns the row."""
    motion, sound = Arrivals(), Arrivals()
    async with connect(target.address, token=target.token) as avatar:

        async def hear() -> None:
            async for message in avatar:
                if isinstance(message, Sound):
                    sound.by_clock.setdefault(message.at, time.monotonic())
                elif isinstance(message, Motion):
                    motion.by_clock.setdefault(message.at, time.monotonic())

        async def speak() -> None:
            piece = 0.1 * np.random.default_rng(0).standard_normal(round(PIECE_S * SAMPLE_RATE_HZ)).astype(np.float32)
            began, sent = time.monotonic(), -LEAD_S
            while True:
                await avatar.speak(piece, end=False)
                sent += PIECE_S
                await asyncio.sleep(began + sent - time.monotonic())

        tasks = [asyncio.create_task(hear()), asyncio.create_task(speak())]
        try:
            await asyncio.sleep(QUIET_S)
            with begin(avatar.ready.session):
                since = time.monotonic()
                await asyncio.wait(tasks, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
                until = time.monotonic()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        heard, got = sound.lateness(since, until, avatar.ready.chunk_samples)
        seen, _ = motion.lateness(since, until, avatar.ready.chunk_samples)
    return {
        "got": got,
        "sent": len(heard),
        "worst_s": round(max(heard + seen, default=0.0), 2),
        "median_s": round(median(heard + seen), 2),
    }


def measure(name: str, target: Target, seconds: float) -> dict[str, Any]:
    """One row: the speaker beside one neighbour."""
    if name in WITH_VIDEO and not target.offer:
        return {"skipped": "needs aiortc; run: pip install 'echoavatar[video]'"}
    if name in WITH_VIDEO and not viewers_of(target):
        return {"skipped": "this server shows no video; start it with --video"}
    if name in WITH_TLS and not target.address.startswith("https"):
        return {"skipped": "this server speaks no TLS"}

    @contextmanager
    def begin(session: str) -> Iterator[None]:
        work = multiprocessing.get_context("spawn").Process(
            target=attack, args=(name, target._replace(session=session)), daemon=True
        )
        work.start()
        try:
            yield
            if work.exitcode:
                raise EchoAvatarError(f"the neighbour {name!r} ended by itself; its error stands above")
        finally:
            work.kill()
            work.join()

    return asyncio.run(listen(target, seconds, begin))


# ---- the server


@contextmanager
def served(model: str, token: str, *, video: bool, files: tuple[Path, Path] | None = None) -> Iterator[str]:
    """A server in a process of its own; yields its address. Raises EchoAvatarError if it did not start."""
    with listen_here("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "echoavatar", "serve", "--model", model, "--port", str(port)]
    command += ["--video"] if video else []
    command += ["--certificate", str(files[0]), "--key", str(files[1])] if files else []
    with subprocess.Popen(command, env={**os.environ, TOKEN: token}, stdout=subprocess.DEVNULL) as process:
        try:
            end = time.monotonic() + START_S
            while not _is_open(port):
                if process.poll() is not None or time.monotonic() > end:
                    raise EchoAvatarError("the server did not start; try `echoavatar serve`")
                time.sleep(0.2)
            yield f"{'https' if files else 'http'}://127.0.0.1:{port}"
        finally:
            process.terminate()


def bench_neighbours(
    model: str,
    *,
    servers: tuple[str, ...],
    token: str,
    certificate: str,
    only: tuple[str, ...],
    seconds: float,
    tell: Callable[[dict[str, Any]], None],
) -> list[dict[str, Any]]:
    """Measure each neighbour at each server, at one of our own if none is given; `tell` receives each row.

    Raises EchoAvatarError if there is no such neighbour, or no server.
    """
    names = only or tuple(NEIGHBOURS)
    if unknown := set(names) - set(NEIGHBOURS):
        raise EchoAvatarError(f"there is no neighbour {min(unknown)!r}; choose from {', '.join(NEIGHBOURS)}")
    offer, rows = make_offer(), []

    def row(name: str, address: str, key: str, authority: str) -> None:
        target = Target(address, key, "", authority, offer)
        rows.append({"neighbour": name, "server": address, **measure(name, target, seconds)})
        tell(rows[-1])

    if servers:
        with trusted(certificate):
            for name in names:
                for address in servers:
                    row(name, _web(address), token, certificate)
        return rows
    key = secrets.token_urlsafe(8)
    plain = [name for name in names if name not in WITH_TLS]
    if plain:
        with served(model, key, video=bool(offer)) as address:
            for name in plain:
                row(name, address, key, "")
    if len(plain) < len(names):
        with certified() as files, served(model, key, video=False, files=files) as address:
            for name in WITH_TLS:
                row(name, address, key, str(files[0]))
    return rows


@contextmanager
def certified() -> Iterator[tuple[Path, Path]]:
    """A certificate for 127.0.0.1 and its key, made with the `openssl` program, which this process trusts."""
    with tempfile.TemporaryDirectory() as folder:
        certificate, key = Path(folder) / "certificate.pem", Path(folder) / "key.pem"
        command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1"]
        command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]
        try:
            subprocess.run(command, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise EchoAvatarError(f"openssl made no certificate ({error}); leave the TLS neighbour out") from error
        with trusted(str(certificate)):
            yield certificate, key


@contextmanager
def trusted(certificate: str) -> Iterator[None]:
    """This process trusts the certificate of a file; an empty name changes nothing."""
    before = os.environ.get("SSL_CERT_FILE")
    os.environ.update({"SSL_CERT_FILE": certificate} if certificate else {})
    try:
        yield
    finally:
        os.environ.pop("SSL_CERT_FILE", None)
        os.environ.update({"SSL_CERT_FILE": before} if before else {})


def _web(address: str) -> str:
    parts = urlsplit(address if "://" in address else f"http://{address}")
    return f"{parts.scheme.replace('ws', 'http', 1)}://{parts.netloc}"


def _is_open(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5):
        return True
    return False
