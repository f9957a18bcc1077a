"""Sessions, seats and ticks: who is served when. May import `pipeline` and below."""

from .engine import Engine
from .session import Session

__all__ = ["Engine", "Session"]
