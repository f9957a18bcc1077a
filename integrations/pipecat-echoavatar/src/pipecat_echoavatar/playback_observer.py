"""Observe what the transport writes of the avatar's sound: a pipeline's best knowledge of what was heard."""

import time

from pipecat.observers.base_observer import BaseObserver, FramePushed
from pipecat.processors.frame_processor import FrameDirection
from pipecat.transports.base_output import BaseOutputTransport

from echoavatar.agents.integrations import AvatarBridge

from .frames import AvatarMusicFrame, AvatarSpeechFrame


class PlaybackObserver(BaseObserver):
    """Reports each block of sound to the bridge; an output transport pushes a block on once it is written."""

    def __init__(self, bridge: AvatarBridge) -> None:
        super().__init__()
        self._bridge = bridge

    async def on_push_frame(self, data: FramePushed) -> None:
        """Handle a pushed frame."""
        frame = data.frame
        if (
            isinstance(frame, AvatarSpeechFrame | AvatarMusicFrame)
            and isinstance(data.source, BaseOutputTransport)
            and data.direction is FrameDirection.DOWNSTREAM
        ):
            seconds = frame.num_frames / frame.sample_rate
            self._bridge.playback.wrote(seconds, time.monotonic())
