"""A simulated room of two, which carries LiveKit's documented protocol, and a simulated audio source."""

import asyncio
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from livekit import rtc


class Track:
    """A data track."""

    def __init__(self, name: str) -> None:
        self.name, self.frames, self.is_there, self.is_full = name, [], True, False  # type: ignore[var-annotated]

    def try_push(self, frame: rtc.DataTrackFrame) -> None:
        if self.is_full or not self.is_there:
            raise rtc.PushFrameError("full" if self.is_there else "gone")
        self.frames.append(frame)

    def is_published(self) -> bool:
        return self.is_there

    async def unpublish(self) -> None:
        self.is_there = False


class Participant:
    def __init__(self, room: "Room", identity: str) -> None:
        self.room, self.identity, self.attributes = room, identity, {}  # type: ignore[var-annotated]
        self.kind = rtc.ParticipantKind.PARTICIPANT_KIND_AGENT
        self.state = rtc.ParticipantState.PARTICIPANT_STATE_ACTIVE
        self._rpc_handlers: dict[str, Callable[..., Any]] = {}
        self.data_tracks: list[Track] = []
        self.tracks: list[Any] = []
        self.has_data_tracks = True

    def register_rpc_method(self, name: str, handler: Callable[..., Any]) -> None:
        self._rpc_handlers[name] = handler

    async def perform_rpc(self, *, destination_identity: str, method: str, payload: str) -> str:
        await asyncio.sleep(0.005)
        other = self.room.others[destination_identity]
        handler = other.local_participant._rpc_handlers.get(method)
        if handler is None:
            code = rtc.RpcError.ErrorCode.UNSUPPORTED_METHOD
            raise rtc.RpcError(code, "unsupported")
        data = rtc.RpcInvocationData("1", self.identity, payload, 10.0)
        answer = handler(data)
        return await answer if asyncio.iscoroutine(answer) else answer

    async def stream_bytes(
        self, *, name: str, topic: str, destination_identities: list[str], attributes: dict[str, str]
    ) -> "Writer":
        reader = Reader(attributes)
        for identity in destination_identities:
            self.room.others[identity].byte_handlers[topic](reader, self.identity)
        return Writer(reader)

    async def publish_data(
        self, payload: bytes, *, reliable: bool, topic: str, destination_identities: list[str] | None = None
    ) -> None:
        assert reliable
        assert len(payload) <= 15 * 1024, "LiveKit's limit"
        self.room.data.append((topic, payload, destination_identities or []))

    async def publish_data_track(self, *, name: str) -> Track:
        if not self.has_data_tracks:
            raise rtc.PublishDataTrackError("not supported")
        self.data_tracks.append(Track(name))
        return self.data_tracks[-1]

    async def publish_track(self, track: Any, options: Any) -> Any:
        self.tracks.append(track)

        async def subscribed() -> None:
            pass

        return SimpleNamespace(sid=f"TR_{len(self.tracks)}", wait_for_subscription=subscribed)

    async def unpublish_track(self, sid: str) -> None:
        self.tracks.clear()


class Reader:
    def __init__(self, attributes: dict[str, str]) -> None:
        self.info = SimpleNamespace(attributes=attributes, stream_id="s")
        self.queue: asyncio.Queue[bytes | None] = asyncio.Queue()

    async def __anext__(self) -> bytes:
        block = await self.queue.get()
        if block is None:
            raise StopAsyncIteration
        return block


class Writer:
    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    async def write(self, block: bytes) -> None:
        self._reader.queue.put_nowait(block)

    async def aclose(self) -> None:
        self._reader.queue.put_nowait(None)


class Room(rtc.EventEmitter[str]):
    name = "room"

    def __init__(self, identity: str) -> None:
        super().__init__()
        self.local_participant = Participant(self, identity)
        self.others: dict[str, Room] = {}
        self.byte_handlers: dict[str, Callable[..., None]] = {}
        self.data: list[tuple[str, bytes, list[str]]] = []

    @property
    def remote_participants(self) -> dict[str, Participant]:
        return {identity: room.local_participant for identity, room in self.others.items()}

    def isconnected(self) -> bool:
        return True

    def register_byte_stream_handler(self, topic: str, handler: Callable[..., None]) -> None:
        self.byte_handlers[topic] = handler


def pair(one: str, other: str) -> tuple[Room, Room]:
    rooms = Room(one), Room(other)
    rooms[0].others[other], rooms[1].others[one] = rooms[1], rooms[0]
    return rooms


class Speaker:
    """An audio source that plays into memory, in real time."""

    def __init__(self) -> None:
        self.queue = np.zeros(0, np.int16)
        self.heard = np.zeros(0, np.int16)
        self._since = 0.0

    def _play(self) -> None:
        now = time.monotonic()
        count = min(len(self.queue), int((now - self._since) * 24_000))
        self._since = self._since + count / 24_000 if count < len(self.queue) else now
        self.heard = np.concatenate([self.heard, self.queue[:count]])
        self.queue = self.queue[count:]

    @property
    def queued_duration(self) -> float:
        self._play()
        return len(self.queue) / 24_000

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        self._play()
        if not len(self.queue):
            self._since = time.monotonic()
        self.queue = np.concatenate([self.queue, np.frombuffer(frame.data, np.int16)])

    def clear_queue(self) -> None:
        self._play()
        self.queue = self.queue[:0]
