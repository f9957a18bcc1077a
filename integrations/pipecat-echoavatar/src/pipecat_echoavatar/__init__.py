"""EchoAvatar for Pipecat: a processor between the voice and the transport."""

from .frames import AvatarMusicFrame, AvatarSpeechFrame
from .null_transport import NullTransport
from .processor import EchoAvatarProcessor

__all__ = ["AvatarMusicFrame", "AvatarSpeechFrame", "EchoAvatarProcessor", "NullTransport"]
