"""The avatar's own frame types, which distinguish its sound from other sound, and its messages."""

from dataclasses import dataclass
from typing import Any

import msgspec
from pipecat.frames.frames import OutputAudioRawFrame, TTSAudioRawFrame

from echoavatar.wire.messages import ServerMessage


@dataclass
class AvatarSpeechFrame(TTSAudioRawFrame):
    """Speech, mixed with any music that plays."""


@dataclass
class AvatarMusicFrame(OutputAudioRawFrame):
    """Music alone: the bot is not speaking."""


def rtvi(message: ServerMessage) -> dict[str, Any]:
    """Wrap a message of protocol `echoavatar.v1` as an RTVI server message, bytes in base64.

    Stock `@pipecat-ai/client-js` hands `data` to `onServerMessage`.
    """
    payload = msgspec.to_builtins(message)
    return {"label": "rtvi-ai", "type": "server-message", "data": {"type": "echoavatar", "message": payload}}


def asks_for_avatar(message: Any) -> bool:
    """Whether a client has just connected or asks for the avatar; seen only if Pipecat's own RTVI is off."""
    if not isinstance(message, dict) or message.get("label") != "rtvi-ai":
        return False
    data = message.get("data")
    is_asking = isinstance(data, dict) and data.get("t") == "echoavatar"
    return message.get("type") == "client-ready" or (message.get("type") == "client-message" and is_asking)
