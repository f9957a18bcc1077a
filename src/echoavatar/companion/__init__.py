"""Somebody to talk to: what a user said becomes what the avatar says and does. May import `errors` only.

With an OpenAI-compatible endpoint (`ChatModel`, environment variables) it is a model, else a small script (`Scripted`)
that knows how to show what the avatar can do. Neither holds a conversation: who asks, brings what was said before.
"""

from .model import ChatModel
from .persona import PERSONA
from .script import Scripted
from .talk import Companion, Doing, Said, from_environment

__all__ = ["PERSONA", "ChatModel", "Companion", "Doing", "Said", "Scripted", "from_environment"]
