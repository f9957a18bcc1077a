"""EchoAvatar for Pipecat: a processor between the voice and the transport."""

from .frames import AvatarMusicFrame, AvatarSpeechFrame
from .processor import EchoAvatarProcessor
from .silent import SilentTransport

__all__ = ["AvatarMusicFrame", "AvatarSpeechFrame", "EchoAvatarProcessor", "SilentTransport"]
