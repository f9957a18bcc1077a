"""The avatar that listens in on one Realtime connection: hears what is said, and sends its motion beside the voice.

Nothing here can hold up or harm the voice: events come in through a bounded queue that is filled without waiting, what
the avatar adds is left out while the client is behind, and when the avatar fails, it alone is tried again.
"""

import asyncio
import json
import logging
from collections import deque
from contextlib import suppress
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from ..client import Avatar, RemoteTools, connect
from ..errors import EchoAvatarError
from ..timing import ChunkSize
from ..wire import Ready, Sound
from . import added
from .calls import Calls
from .events import Event, inside, is_for_us, read, with_tools
from .hearing import Hearing
from .settings import ProxySettings
from .showing import Showing

_LOG = logging.getLogger(__name__)
MOST_WAITING = 1 << 25  # bytes of events not looked at yet: minutes of sound
BEHIND = 1 << 15  # bytes that wait to leave for the client: it is behind, and gets the voice only
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 15.0


class AvatarLink:
    """One conversation's avatar; `run` it until the conversation ends."""

    def __init__(
        self, settings: ProxySettings, *, client: ServerConnection, upstream: ClientConnection
    ) -> None:
        self.dropped = 0  # events of ours that a slow client was spared
        self._settings, self._client, self._upstream = settings, client, upstream
        self._queue: deque[tuple[bool, str | bytes]] = deque()
        self._waiting = 0
        self._filled = asyncio.Event()
        self._hearing = Hearing()
        self._tools = RemoteTools(settings.avatar, token=settings.token) if settings.avatar else None
        self._calls = Calls(self._send_up, self._do)
        self._avatar: Avatar | None = None
        self._is_greeted = asyncio.Event()  # the upstream has spoken first

    # ---- what the relay shows us; must not wait, must not raise

    def hear_server(self, message: str | bytes) -> None:
        """An event of the model's was passed on."""
        self._is_greeted.set()
        self._put(True, message)

    def hear_client(self, message: str | bytes) -> None:
        """An event of the client's was passed on."""
        self._put(False, message)

    def rewrite(self, message: str | bytes) -> str | bytes | None:
        """What is to be passed on instead of a client's event; nothing of one that is for us."""
        if self._tools is None:
            return message
        try:
            if is_for_us(message):
                return None
            return with_tools(message, self._calls.with_ours) if self._calls.declared else message
        except Exception:  # the outer edge: what we cannot read goes on as it came
            _LOG.exception("a client's event was not understood")
            return message

    def _put(self, is_server: bool, message: str | bytes) -> None:
        if self._tools is None:
            return
        if self._waiting > MOST_WAITING:
            self._queue.clear()
            self._waiting = 0
            self._hearing.lose()
        self._queue.append((is_server, message))
        self._waiting += len(message)
        self._filled.set()

    # ---- the avatar's life

    async def run(self) -> None:
        """Until cancelled. Whatever happens to the avatar is told to the client, and it is tried again."""
        if self._tools is None:
            return
        reader = asyncio.create_task(self._read())
        try:
            wait = FIRST_WAIT_S
            while True:
                reason = "the avatar's session ended"
                try:
                    async with connect(self._settings.avatar, token=self._settings.token) as avatar:
                        wait = FIRST_WAIT_S
                        await self._live(avatar)
                except (EchoAvatarError, ConnectionClosed, OSError) as error:
                    reason = str(error)
                except Exception:  # the outer edge: a mistake of ours must not end the voice
                    _LOG.exception("the avatar failed")
                    reason = "the avatar failed; see the proxy's log"
                self._avatar = None
                self._hearing.lose()
                _LOG.warning("no avatar: %s; the voice goes on", reason)
                await self._send_down(added.session_lost(reason))
                await asyncio.sleep(wait)
                wait = min(LONGEST_WAIT_S, 2 * wait)
        finally:
            reader.cancel()
            self._calls.cancel()
            self._hearing.lose()

    async def _live(self, avatar: Avatar) -> None:
        await self._is_greeted.wait()
        await self._begin(avatar)
        showing = Showing(self._hearing, avatar.ready, idle=self._settings.idle)
        async for message in avatar:
            if isinstance(message, Ready):
                if not message.resumed:
                    self._hearing.lose()
                await self._begin(avatar)
                showing = Showing(self._hearing, avatar.ready, idle=self._settings.idle)
                continue
            if isinstance(message, Sound):
                self._hearing.note(message)
            for event in showing.take(message):
                await self._send_down(event)

    async def _begin(self, avatar: Avatar) -> None:
        """A session of the avatar's, new or gone on with."""
        assert self._tools is not None
        self._tools.session = avatar.ready.session
        self._hearing.begin(ChunkSize.of(avatar.ready.chunk_samples))
        self._avatar = avatar
        await self._send_down(added.session_created(avatar.ready))
        if self._settings.tools and not self._calls.declared:
            self._calls.declared = await asyncio.to_thread(self._tools.schemas, "openai")
            await self._calls.offer()

    # ---- what was heard

    async def _read(self) -> None:
        while True:
            while not self._queue:
                self._filled.clear()
                await self._filled.wait()
            is_server, message = self._queue.popleft()
            self._waiting -= len(message)
            event = read(message)
            if event is None:
                continue
            try:
                await (self._server_says(event) if is_server else self._client_says(event))
            except ConnectionClosed:
                continue  # `run` knows too
            except Exception:  # the outer edge: one event that we misread
                _LOG.exception("an event of type %.60r was not understood", event.type)

    async def _server_says(self, event: Event) -> None:
        now = asyncio.get_running_loop().time()
        await self._hearing.server_says(event, self._avatar, now)
        if not self._settings.tools:
            return
        if event.type == "session.created":
            self._calls.session_tells(event.session, is_first=True)
            await self._calls.offer()
        elif event.type == "input_audio_buffer.speech_started":
            self._calls.user_spoke()
        else:
            self._calls.notice(event)

    async def _client_says(self, event: Event) -> None:
        await self._hearing.client_says(event, self._avatar, asyncio.get_running_loop().time())
        if event.type == "session.update":
            self._calls.session_tells(event.session)
        elif event.type == "conversation.item.create" and inside(event.item, "type") == "message":
            self._calls.user_spoke()

    async def _do(self, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        if self._tools is None or self._avatar is None:
            return {"status": "rejected", "reason": "the avatar is not there now"}
        return await self._tools.call_async(name, arguments)

    # ---- what we say

    async def _send_up(self, event: dict[str, Any]) -> None:
        with suppress(ConnectionClosed):
            await self._upstream.send(json.dumps(event))

    async def _send_down(self, event: added.Added) -> None:
        """To the client, unless it is behind with reading."""
        await self._is_greeted.wait()
        if self._client.transport.get_write_buffer_size() > BEHIND:
            self.dropped += 1
            return
        with suppress(ConnectionClosed):
            await self._client.send(added.encode(event))
