"""The avatar beside one Realtime connection: it listens to the events and sends its motion to the client.

Nothing here can delay or break the voice. Events arrive through a bounded queue that is filled without waiting; motion
is left out while the client is slow; and when the avatar fails, only the avatar is restarted.
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

from echoavatar.errors import EchoAvatarError
from echoavatar.timing import ChunkSize
from echoavatar.wire.messages import Ready, Sound

from ..client import Avatar, RemoteTools, connect
from . import avatar_events
from .avatar_events import EventWriter
from .conversation import Conversation
from .events import MOST_BYTES, Event, inside, is_for_us, read, with_tools
from .tool_calls import ToolCalls
from .upstream import ProxySettings

_LOG = logging.getLogger(__name__)
MAX_QUEUED_BYTES = 1 << 25  # events waiting to be read: minutes of sound
MAX_UNSENT_BYTES = 1 << 15  # above this the client is slow, and gets the voice only
MIN_RETRY_S, MAX_RETRY_S = 0.5, 15.0


class AvatarSidecar:
    """The avatar of one conversation; `run` it until the conversation ends."""

    def __init__(self, settings: ProxySettings, *, client: ServerConnection, upstream: ClientConnection) -> None:
        self._settings, self._client, self._upstream = settings, client, upstream
        self._queue: deque[tuple[bool, str | bytes]] = deque()
        self._queued_bytes = 0
        self._filled = asyncio.Event()
        self._conversation = Conversation()
        self._tools = RemoteTools(settings.avatar, token=settings.token) if settings.avatar else None
        self._tool_calls = ToolCalls(self._send_up, self._call_tool)
        self._avatar: Avatar | None = None
        self._upstream_spoke = asyncio.Event()  # the first event of the upstream has been forwarded

    # ---- called by the relay; must not wait and must not raise

    def observe(self, message: str | bytes, *, is_server: bool) -> None:
        """Take an event, of the model or of the client, that was forwarded."""
        if is_server:
            self._upstream_spoke.set()
        if self._tools is None:
            return
        if self._queued_bytes > MAX_QUEUED_BYTES:
            self._queue.clear()
            self._queued_bytes = 0
            self._conversation.detach()
        self._queue.append((is_server, message))
        self._queued_bytes += len(message)
        self._filled.set()

    def rewrite(self, message: str | bytes) -> str | bytes | None:
        """What to forward instead of a client's event; None if the event is addressed to the proxy."""
        if self._tools is None:
            return message
        try:
            if is_for_us(message):
                return None
            return with_tools(message, self._tool_calls.with_ours) if self._tool_calls.declared else message
        except Exception:  # outer edge: an event that we cannot read is forwarded unchanged
            _LOG.exception("a client's event could not be read")
            return message

    # ---- connection to the avatar

    async def run(self) -> None:
        """Keep an avatar connected until cancelled. A failure is reported to the client and tried again."""
        if self._tools is None:
            return
        reader = asyncio.create_task(self._read())
        try:
            wait = MIN_RETRY_S
            while True:
                reason = "the avatar's session ended"
                try:
                    async with connect(self._settings.avatar, token=self._settings.token) as avatar:
                        wait = MIN_RETRY_S
                        await self._serve(avatar)
                except (EchoAvatarError, ConnectionClosed, OSError) as error:
                    reason = str(error)
                except Exception:  # outer edge: a bug on the avatar's side must not end the voice
                    _LOG.exception("the avatar failed")
                    reason = "the avatar failed; see the proxy's log"
                self._avatar = None
                self._conversation.detach()
                _LOG.warning("the avatar is not available (%s); the voice goes on", reason)
                await self._send_down(avatar_events.session_lost(reason))
                await asyncio.sleep(wait)
                wait = min(MAX_RETRY_S, 2 * wait)
        finally:
            reader.cancel()
            self._tool_calls.cancel()
            self._conversation.detach()

    async def _serve(self, avatar: Avatar) -> None:
        await self._upstream_spoke.wait()
        writer = await self._attach(avatar)
        async for message in avatar:
            if isinstance(message, Ready):
                if not message.resumed:
                    self._conversation.detach()
                writer = await self._attach(avatar)
                continue
            if isinstance(message, Sound):
                self._conversation.on_avatar_sound(message)
            for event in writer.events_for(message):
                await self._send_down(event)

    async def _attach(self, avatar: Avatar) -> EventWriter:
        """Use an avatar session, new or resumed."""
        assert self._tools is not None
        self._tools.session = avatar.ready.session
        self._conversation.attach(ChunkSize.of(avatar.ready.chunk_samples))
        self._avatar = avatar
        await self._send_down(avatar_events.session_created(avatar.ready))
        if self._settings.tools and not self._tool_calls.declared:
            self._tool_calls.declared = await asyncio.to_thread(self._tools.schemas, "openai")
            await self._tool_calls.offer()
        return EventWriter(self._conversation, avatar.ready, idle=self._settings.idle)

    # ---- events, off the relay's path

    async def _read(self) -> None:
        while True:
            await asyncio.sleep(0)  # a flood of events must not hold up other conversations
            while not self._queue:
                self._filled.clear()
                await self._filled.wait()
            is_server, message = self._queue.popleft()
            self._queued_bytes -= len(message)
            event = read(message)
            if event is None:
                if is_server:
                    large = len(message) > MOST_BYTES
                    self._conversation.miss(repr(message[:40]), "it is too large" if large else "it is no event")
                continue
            try:
                await (self._on_server_event(event) if is_server else self._on_client_event(event))
            except ConnectionClosed:
                continue  # `run` sees it too
            except Exception:  # outer edge: one event that was misread
                _LOG.exception("an event of type %.60r could not be handled", event.type)

    async def _on_server_event(self, event: Event) -> None:
        now = asyncio.get_running_loop().time()
        await self._conversation.on_server_event(event, self._avatar, now)
        if not self._settings.tools:
            return
        if event.type in ("session.created", "conversation.created"):  # xAI sends the second only
            self._tool_calls.on_session(event.session, is_first=True)
            await self._tool_calls.offer()
        elif event.type == "input_audio_buffer.speech_started":
            self._tool_calls.on_user_turn()
        else:
            self._tool_calls.on_model_event(event)

    async def _on_client_event(self, event: Event) -> None:
        await self._conversation.on_client_event(event, self._avatar, asyncio.get_running_loop().time())
        if event.type == "session.update":
            self._tool_calls.on_session(event.session)
        elif event.type == "conversation.item.create" and inside(event.item, "type") == "message":
            self._tool_calls.on_user_turn()

    async def _call_tool(self, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        if self._tools is None or self._avatar is None:
            return {"status": "rejected", "reason": "the avatar is not connected"}
        return await self._tools.call_async(name, arguments)

    # ---- sending

    async def _send_up(self, event: dict[str, Any]) -> None:
        with suppress(ConnectionClosed):
            await self._upstream.send(json.dumps(event))

    async def _send_down(self, event: avatar_events.AvatarEvent) -> None:
        """Send an event to the client, unless the client is slow."""
        await self._upstream_spoke.wait()
        if self._client.transport.get_write_buffer_size() <= MAX_UNSENT_BYTES:
            with suppress(ConnectionClosed):
                await self._client.send(avatar_events.encode(event))
