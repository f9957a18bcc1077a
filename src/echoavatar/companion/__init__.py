"""Somebody to talk to: what a user said becomes what the avatar says and does. May import `errors` only.

With an OpenAI-compatible endpoint (`ChatModel`, environment variables) it is a model, else a small script (`Scripted`)
that knows how to show what the avatar can do. Neither holds a conversation: who asks, brings what was said before.
"""

from .environment import from_environment
from .model import PERSONA, ChatModel
from .script import Scripted
from .talk import Companion, Doing, Said

__all__ = ["PERSONA", "ChatModel", "Companion", "Doing", "Said", "Scripted", "from_environment"]
