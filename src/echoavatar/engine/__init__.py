"""Sessions, seats and ticks: who is served when. May import `pipeline` and below."""

from .acts import ActStatus
from .engine import Engine, load
from .offline import Animation, animate, animate_many, in_blocks
from .screen import Delivery
from .session import Session
from .thread import EngineThread

__all__ = [
    "ActStatus",
    "Animation",
    "Delivery",
    "Engine",
    "EngineThread",
    "Session",
    "animate",
    "animate_many",
    "in_blocks",
    "load",
]
