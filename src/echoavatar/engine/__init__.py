"""Sessions, seats and ticks: who is served when. May import `pipeline` and below."""

from .engine import Engine, load
from .offline import Animation, animate, in_blocks
from .session import Session

__all__ = ["Animation", "Engine", "Session", "animate", "in_blocks", "load"]
