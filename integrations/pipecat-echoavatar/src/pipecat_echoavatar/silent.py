"""A transport that sounds nowhere: for a bot whose avatar's page is its loudspeaker, and for tests."""

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


class SilentTransport(BaseOutputTransport):
    """Takes sound at the speed of playback, as a device would, and keeps messages for whoever asks."""

    def __init__(self, params: TransportParams | None = None, **kwargs: Any) -> None:
        super().__init__(params or TransportParams(audio_out_enabled=True), **kwargs)
        self._due = 0.0

    async def start(self, frame: StartFrame) -> None:
        """Ready at once."""
        await super().start(frame)
        await self.set_transport_ready(frame)

    async def write_audio_frame(self, frame: OutputAudioRawFrame) -> bool:
        """Return when a device would want the next block."""
        now = time.monotonic()
        if now > self._due + LATE_S:  # it was silent for a while
            self._due = now
        self._due += frame.num_frames / frame.sample_rate
        await asyncio.sleep(max(0.0, self._due - now))
        return True

    async def send_message(
        self, frame: OutputTransportMessageFrame | OutputTransportMessageUrgentFrame
    ) -> None:
        """Nobody is there."""
