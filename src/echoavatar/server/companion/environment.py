"""Choose the companion from environment variables."""

import os
from collections.abc import Mapping
from pathlib import Path

from echoavatar.errors import EchoAvatarError

from .model import PERSONA, ChatModel
from .script import Scripted
from .talk import Companion


def from_environment(environment: Mapping[str, str] = os.environ) -> Companion:
    """A language model if `ECHOAVATAR_CHAT_URL` is set, else the script.

    `ECHOAVATAR_CHAT_MODEL`, `ECHOAVATAR_CHAT_KEY`, `ECHOAVATAR_CHAT_EARS` (a model that transcribes speech) and
    `ECHOAVATAR_PERSONA` (a text file) configure the model.

    Raises:
        EchoAvatarError: the address is not valid, the model is not named, or the file cannot be read.
    """
    url = environment.get("ECHOAVATAR_CHAT_URL", "")
    if not url:
        return Scripted()
    path = environment.get("ECHOAVATAR_PERSONA", "")
    try:
        persona = Path(path).read_text("utf-8") if path else PERSONA
    except (OSError, UnicodeError) as error:
        raise EchoAvatarError(f"ECHOAVATAR_PERSONA: cannot read {path}; give a text file") from error
    return ChatModel(
        url,
        model=environment.get("ECHOAVATAR_CHAT_MODEL", ""),
        key=environment.get("ECHOAVATAR_CHAT_KEY", ""),
        transcriber=environment.get("ECHOAVATAR_CHAT_EARS", ""),
        persona=persona,
    )
