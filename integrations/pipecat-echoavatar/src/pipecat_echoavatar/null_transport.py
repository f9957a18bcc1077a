"""A transport without a loudspeaker: for bots whose avatar's page plays the sound, and for tests."""

import asyncio
import time
from typing import Any

from pipecat.frames.frames import (
    OutputAudioRawFrame,
    OutputTransportMessageFrame,
    OutputTransportMessageUrgentFrame,
    StartFrame,
)
from pipecat.transports.base_output import BaseOutputTransport
from pipecat.transports.base_transport import TransportParams

LATE_S = 0.1


class NullTransport(BaseOutputTransport):
    """Accepts sound at the speed of playback, as a device would, and discards it."""

    def __init__(self, params: TransportParams | None = None, **kwargs: Any) -> None:
        super().__init__(params or TransportParams(audio_out_enabled=True), **kwargs)
        self._due = 0.0

    async def start(self, frame: StartFrame) -> None:
        """Start; the transport is ready at once."""
        await super().start(frame)
        await self.set_transport_ready(frame)

    async def write_audio_frame(self, frame: OutputAudioRawFrame) -> bool:
        """Return when a device would want the next block."""
        now = time.monotonic()
        if now > self._due + LATE_S:  # after a pause
            self._due = now
        self._due += frame.num_frames / frame.sample_rate
        await asyncio.sleep(max(0.0, self._due - now))
        return True

    async def send_message(self, frame: OutputTransportMessageFrame | OutputTransportMessageUrgentFrame) -> None:
        """Discard the message."""
