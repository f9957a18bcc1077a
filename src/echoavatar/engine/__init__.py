"""Sessions, seats and ticks: who is served when. May import `pipeline` and below."""

from .engine import Engine, load
from .offline import Animation, animate, animate_many, in_blocks
from .session import Session

__all__ = ["Animation", "Engine", "Session", "animate", "animate_many", "in_blocks", "load"]
