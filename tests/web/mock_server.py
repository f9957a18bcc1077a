"""A mock server for tests of the page: no models, every frame encodes its own clock.

It speaks `echoavatar.v1` over the real message types, feeds silence when no sound waits, and paces itself by `played`.
Motion is a gentle sway, or `recorded` clips. With `tell_clock` the hips' Z is the clock (seconds / 1000) and the sound
is a saw of one second, so that what a browser shows and plays can be read off its bones and its loudspeaker.
"""

import argparse
import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.server.clients import ClientLimits, ClientRates
from echoavatar.server.page import PageHeaders, page_routes
from echoavatar.server.settings import ServerSettings
from echoavatar.server.voice import voice_route
from echoavatar.timing import CHUNK_SAMPLES, FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import Pose, pack_audio, pack_pose
from echoavatar.wire.codec import decode_client, encode
from echoavatar.wire.messages import (
    Action,
    ActionStatus,
    Audio,
    End,
    Error,
    Flush,
    Hello,
    Interrupt,
    Latency,
    Limits,
    Music,
    Ping,
    Played,
    Pong,
    Ready,
    Rig,
    Sound,
    State,
    Stats,
)

ROOT = Path(__file__).parents[2]
ASSETS = ROOT / "src/echoavatar/assets"
ACTIONS = ["wave", "raise both hands", "nod", "point left", "bow", "shrug"]
FRAMES = CHUNK_SAMPLES // SAMPLES_PER_FRAME
AHEAD = {True: 1.5, False: 0.4}  # seconds sent ahead of playback: while sound waits, while it does not


class MockSession:
    """One connection's clock, sound and replies."""

    def __init__(
        self, socket: WebSocket, recorded: Mapping[str, np.ndarray] | None = None, *, tell_clock: bool = False
    ) -> None:
        self._socket = socket
        self._recorded = recorded or {}
        self._tell_clock = tell_clock
        self._at = self._epoch = self._seg = 0
        self._waiting = np.zeros(0, np.float32)
        self._music = np.zeros(0, np.float32)
        self._played = (0, time.monotonic())
        self._state = "idle"
        self._hears_user = False

    async def run(self) -> None:
        """What follows `greeted`, until the client leaves."""
        await self._send(ready(tracks=["Four steps"] if "music_pcm" in self._recorded else []))
        self._played = (0, time.monotonic())
        pacing = asyncio.create_task(self._pace())
        try:
            while True:
                await self._take(decode_client(await self._socket.receive_bytes()))
        except WebSocketDisconnect:
            pass
        finally:
            pacing.cancel()

    async def _take(self, message: object) -> None:
        match message:
            case Audio(seg=seg, pcm=pcm, speaker="avatar") if seg >= self._seg:
                self._seg = seg
                self._waiting = np.concatenate([self._waiting, np.frombuffer(pcm, "<i2") / 32768])
            case Played(at=at):
                self._played = (at, time.monotonic())
            case Ping(nonce=nonce):
                await self._send(Pong(nonce=nonce, at=self._at))
            case Interrupt(heard=heard, seg=seg):
                await self._interrupt(self._played[0] if heard is None else heard, seg or self._seg)
            case Action(id=id, name=name):
                known = name in ACTIONS
                for status in ("accepted", "started") if known else ("rejected",):
                    await self._status(id, name, status)
                if known:
                    asyncio.get_running_loop().call_later(
                        5.0, lambda: asyncio.ensure_future(self._status(id, name, "done"))
                    )
            case Music(id=id, op=op, title=title):
                await self._status(id, title, "started" if op == "play" else "done")
                self._music = self._recorded["music_pcm"].copy() if op == "play" else np.zeros(0, np.float32)
            case Audio(speaker="user"):
                self._hears_user = True
            case End(speaker="user"):
                self._hears_user = False
            case Audio() | End():
                pass

    async def _interrupt(self, heard: int, seg: int) -> None:
        self._at, self._epoch = heard, self._epoch + 1
        self._waiting, self._music = self._waiting[:0], self._music[:0]
        await self._send(Flush(at=heard, epoch=self._epoch, seg=self._seg, heard=0))
        self._seg = max(self._seg, seg + 1)  # utterances up to `seg` are void, and no later one

    async def _status(self, id: str, name: str, status: str) -> None:
        choices = ACTIONS if status == "rejected" else []
        await self._send(
            ActionStatus(id=id, name=name, status=status, at=self._at, reason="", choices=choices)  # type: ignore[arg-type]
        )

    async def _pace(self) -> None:
        ticks = 0
        while True:
            at, when = self._played
            head = at + (time.monotonic() - when) * SAMPLE_RATE_HZ
            busy = len(self._waiting) + len(self._music) > 0
            if self._at - head < AHEAD[busy] * SAMPLE_RATE_HZ:
                await self._chunk()
            else:
                await asyncio.sleep(0.02)
            ticks += 1
            if ticks % 40 == 0:
                await self._send(self._stats(head))

    async def _chunk(self) -> None:
        speech, self._waiting = self._waiting[:CHUNK_SAMPLES], self._waiting[CHUNK_SAMPLES:]
        music, self._music = self._music[:CHUNK_SAMPLES], self._music[CHUNK_SAMPLES:]
        pcm = np.zeros(CHUNK_SAMPLES)
        pcm[: len(speech)] += speech
        pcm[: len(music)] += music
        if self._tell_clock:  # a sawtooth with a period of one second
            pcm = ((self._at + np.arange(CHUNK_SAMPLES)) % SAMPLE_RATE_HZ / SAMPLE_RATE_HZ - 0.5) * 0.5
        resting = "listening" if self._hears_user else "idle"
        state = "dancing" if len(music) else "speaking" if np.abs(speech).max(initial=0) > 1e-3 else resting
        if state != self._state:
            self._state = state
            finished = 0 if len(self._waiting) else self._seg
            await self._send(State(state=state, at=self._at, seg=self._seg, finished=finished))  # type: ignore[arg-type]
        loudness = np.abs(np.pad(speech + 0, (0, CHUNK_SAMPLES - len(speech)))).reshape(FRAMES, -1).mean(1)
        pose = self._pose(state, loudness)
        await self._send(pack_pose(pose, at=self._at, epoch=self._epoch, state=state))  # type: ignore[arg-type]
        seg = self._seg if len(speech) else 0
        await self._send(Sound(at=self._at, epoch=self._epoch, seg=seg, pcm=pack_audio(pcm)))
        self._at += CHUNK_SAMPLES

    def _pose(self, state: str, loudness: np.ndarray) -> Pose:
        frames = self._at // SAMPLES_PER_FRAME + np.arange(FRAMES)
        seconds = (self._at + np.arange(FRAMES) * SAMPLES_PER_FRAME) / SAMPLE_RATE_HZ
        name = "music" if state == "dancing" else "speech"
        if f"{name}_rotations" in self._recorded:
            clip = frames % len(self._recorded[f"{name}_rotations"])
            rotations = self._recorded[f"{name}_rotations"][clip]
            root = self._recorded[f"{name}_root"][clip].copy()
        else:
            rotations, root = _sway(seconds)
        if self._tell_clock:
            root[:, 2] = seconds / 1000
        face = np.zeros((FRAMES, len(ARKIT_NAMES)), np.float32)
        face[:, ARKIT_NAMES.index("jawOpen")] = np.clip(loudness * 6, 0, 0.7)
        blink = np.clip(1 - np.abs((seconds % 3.4) - 0.1) / 0.1, 0, 1)
        face[:, ARKIT_NAMES.index("eyeBlinkLeft")] = face[:, ARKIT_NAMES.index("eyeBlinkRight")] = blink
        return Pose(rotations, root, face)

    def _stats(self, head: float) -> Stats:
        ahead = (self._at - head) / SAMPLE_RATE_HZ * 1000
        queue = len(self._waiting) / SAMPLE_RATE_HZ * 1000
        return Stats(
            at=self._at, queue_ms=queue, ahead_ms=ahead, step_ms=1.0, rtf=0.01, dropped=0, underruns=0, sessions=1
        )

    async def _send(self, message: object) -> None:
        await self._socket.send_bytes(encode(message))  # type: ignore[arg-type]


async def greeted(socket: WebSocket) -> Hello:
    """Accept a client and read what it says first."""
    await socket.accept(subprotocol="echoavatar.v1.msgpack")
    hello = decode_client(await socket.receive_bytes())
    assert isinstance(hello, Hello)
    return hello


async def refused(socket: WebSocket, error: Error, code: int) -> None:
    """Tell a client why, and close."""
    await socket.send_bytes(encode(error))
    await socket.close(code)


def ready(tracks: Sequence[str] = (), manner: Sequence[str] = ()) -> Ready:
    """What a session of ours tells first."""
    rest = [[float(x) for x in offset] for offset in HUMANOID.config.offsets]
    return Ready(
        version=1, server="mock", session="mock", resume="key", resumed=False, at=0, epoch=0, seg=0, received=0,
        sample_rate=SAMPLE_RATE_HZ, frame_rate=FRAME_RATE_HZ, chunk_samples=CHUNK_SAMPLES,
        rig=Rig(names=list(HUMANOID.names), parents=list(HUMANOID.parents), rest=rest), face=list(ARKIT_NAMES),
        actions=ACTIONS, tracks=list(tracks), manner=tuple(manner),
        latency=Latency(algorithm=266.7, compute=1.0), limits=Limits(),
    )  # fmt: skip


def _sway(seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arms hanging, spine and head rotating slowly."""
    rotations = np.zeros((len(seconds), HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    names = list(HUMANOID.names)
    for name, axis, angle in (
        ("leftUpperArm", 3, -1.2 + 0.25 * np.sin(seconds * 2)),
        ("rightUpperArm", 3, 1.2 + 0.25 * np.sin(seconds * 2)),
        ("spine", 2, 0.2 * np.sin(seconds)),
        ("head", 1, 0.1 * np.sin(seconds * 3)),
    ):
        rotations[:, names.index(name), 0] = np.cos(angle / 2)
        rotations[:, names.index(name), axis] = np.sin(angle / 2)
    root = np.zeros((len(seconds), 3), np.float32)
    root[:, 1] = HUMANOID.config.offsets[0][1]
    return rotations, root


async def _chat(request: Request) -> Response:
    """A companion that repeats the message, long enough to be interrupted."""
    if request.method == "GET":
        return JSONResponse({"name": "parrot", "where": "a cage", "hears": "whisper", "install": ""})
    message = await request.json()
    told = f"You said {message['text']}, and I have heard {len(message['history'])} sayings before it."
    return JSONResponse({"say": told, "did": []})


async def _sessions(request: Request) -> Response:
    return JSONResponse({"sessions": ["mock", "a robot"]})


async def _ears(request: Request) -> Response:
    wav = await request.body()
    return JSONResponse({"text": "something aloud" if wav[:4] == b"RIFF" else ""})


def make_app(
    recorded: Mapping[str, np.ndarray],
    *,
    tell_clock: bool,
    stream: Callable[[WebSocket], Awaitable[None]] | None = None,
    routes: Sequence[BaseRoute] = (),
) -> Starlette:
    """Page, sounds, character and stream under the paths of the real server; `stream` and `routes` come before them."""

    async def usual(socket: WebSocket) -> None:
        await greeted(socket)
        await MockSession(socket, recorded, tell_clock=tell_clock).run()

    return Starlette(
        routes=[
            *routes,
            WebSocketRoute("/v1/stream", stream or usual),
            voice_route(SimpleNamespace(settings=ServerSettings(), clients=ClientLimits(ClientRates(), ""))),  # type: ignore[arg-type]
            Route("/v1/chat", _chat, methods=["GET", "POST"]),
            Route("/v1/sessions", _sessions),
            Route("/v1/chat/ears", _ears, methods=["POST"]),
            *page_routes(),
        ],
        middleware=[Middleware(PageHeaders)],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8790)
    parser.add_argument("--recorded", type=Path, help="folder with speech.npz and music.npz (echoavatar animate)")
    parser.add_argument("--tell-clock", action="store_true")
    args = parser.parse_args()
    recorded: dict[str, np.ndarray] = {}
    if args.recorded:
        import soundfile

        for name in ("speech", "music"):
            with np.load(args.recorded / f"{name}.npz", allow_pickle=False) as clip:
                recorded |= {f"{name}_{key}": clip[key] for key in ("rotations", "root")}
        recorded["music_pcm"] = soundfile.read(ASSETS / "music.ogg", dtype="float32")[0]
    app = make_app(recorded, tell_clock=args.tell_clock)
    uvicorn.run(app, port=args.port, log_level="warning")


if __name__ == "__main__":
    main()
