"""A conversation partner for the live page: decides what the avatar says and does. May import `errors` only.

`ChatModel` asks a language model at any OpenAI-compatible endpoint, set by environment variables. Without one,
`Scripted` shows what the avatar can do. Neither keeps the conversation; the caller passes in what was said before.
"""

from .environment import from_environment
from .model import PERSONA, ChatModel
from .script import Scripted
from .talk import ChatTurn, Companion, ToolAccess

__all__ = ["PERSONA", "ChatModel", "Companion", "ToolAccess", "ChatTurn", "Scripted", "from_environment"]
