"""WebSockets with bounds on what the application never sees: control frames and fragments."""

import time
from typing import Any

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

CLOSE_S = 3.0  # for a client's answer to our close
CONTROL_FRAMES_A_SECOND = 10.0  # pings and pongs of one WebSocket
CONTROL_FRAMES_AT_ONCE = 50.0
MAX_UNREAD_BYTES = 1 << 20  # pongs that a client does not read
MAX_FRAGMENTS = 4_096  # of one message; empty fragments escape the limit on its size


class GuardedWebSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket within these bounds."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.close_timeout = CLOSE_S
        self._allowance, self._counted_at = CONTROL_FRAMES_AT_ONCE, time.monotonic()

    async def send(self, message: Any) -> None:
        """Send, unless the client is gone: each write to a lost socket would be logged."""
        await self.writable.wait()
        if message["type"] != "websocket.send" or not self.transport.is_closing():
            await super().send(message)

    def handle_ping(self) -> None:
        """Answer a ping, unless the client sends too many or does not read the answers."""
        if self._is_allowed():
            super().handle_ping()

    def handle_pong(self, event: Frame) -> None:
        """Take note of a pong, unless the client sends too many."""
        if self._is_allowed():
            super().handle_pong(event)

    def handle_cont(self, event: Frame) -> None:
        """A fragment of a message."""
        if len(self.frames) < MAX_FRAGMENTS:
            super().handle_cont(event)
        else:
            self.transport.abort()

    def _is_allowed(self) -> bool:
        now = time.monotonic()
        earned = (now - self._counted_at) * CONTROL_FRAMES_A_SECOND
        self._allowance, self._counted_at = min(CONTROL_FRAMES_AT_ONCE, self._allowance + earned) - 1, now
        is_read = self.transport.get_write_buffer_size() < MAX_UNREAD_BYTES
        if self._allowance >= 0 and is_read:
            return True
        if not self.transport.is_closing():
            self.transport.abort()
        return False
