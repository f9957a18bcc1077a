"""Sessions over one pipeline: audio queues, barge-in, actions, music, and the threads that step them.

May import `pipeline` and below.
"""

from .action_scheduler import ActStatus
from .engine import Engine, load
from .offline import AnimatedSound, animate, in_blocks
from .pacing import Pacer, Playhead
from .playout import Delivery
from .session import Session, SessionStatus
from .session_core import SessionCore
from .thread import EngineThread

__all__ = [
    "ActStatus",
    "AnimatedSound",
    "Delivery",
    "Engine",
    "EngineThread",
    "Pacer",
    "Playhead",
    "Session",
    "SessionCore",
    "SessionStatus",
    "animate",
    "in_blocks",
    "load",
]
