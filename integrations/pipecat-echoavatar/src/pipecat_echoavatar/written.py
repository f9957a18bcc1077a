"""What the transport wrote of the avatar's sound, which is the nearest to what was heard that a pipeline knows."""

import time

from pipecat.observers.base_observer import BaseObserver, FramePushed
from pipecat.processors.frame_processor import FrameDirection
from pipecat.transports.base_output import BaseOutputTransport

from echoavatar.integrations import Stage

from .frames import AvatarMusicFrame, AvatarSpeechFrame


class WrittenObserver(BaseObserver):
    """Output transports push a block of sound on once it is written: each is told to the stage."""

    def __init__(self, stage: Stage) -> None:
        super().__init__()
        self._stage = stage

    async def on_push_frame(self, data: FramePushed) -> None:
        """A frame was pushed somewhere."""
        frame = data.frame
        if (
            isinstance(frame, AvatarSpeechFrame | AvatarMusicFrame)
            and isinstance(data.source, BaseOutputTransport)
            and data.direction is FrameDirection.DOWNSTREAM
        ):
            seconds = frame.num_frames / frame.sample_rate
            self._stage.playback.wrote(seconds, time.monotonic())
