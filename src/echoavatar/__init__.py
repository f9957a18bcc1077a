"""EchoAvatar: an audio stream becomes full-body motion, in real time.

>>> from echoavatar import load
>>> with load("default").open(seed=1) as session:
...     session.push(samples, rate=48_000)
...     for chunk in session:
...         chunk.rotations, chunk.root
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .engine import Animation, Engine, Session, animate, load
    from .errors import EchoAvatarError
    from .motion.kinematics import Motion

__version__ = "0.1.0"
__all__ = ["Animation", "EchoAvatarError", "Engine", "Motion", "Session", "animate", "load"]

_HOMES = {"EchoAvatarError": ".errors", "Motion": ".motion.kinematics"}


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, so that `echoavatar --help` does not load torch."""
    if name not in __all__:
        raise AttributeError(f"module 'echoavatar' has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, ".engine"), __name__), name)
