"""EchoAvatar: an audio stream becomes full-body motion, in real time.

>>> import echoavatar
>>> animation = echoavatar.animate("talk.wav")
>>> animation.save("talk.glb")

Live:

>>> from echoavatar import load
>>> with load("default").open(seed=1) as session:
...     session.push(samples, rate=48_000)
...     for chunk in session:
...         chunk.rotations, chunk.root
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .animation import Animation, animate
    from .engine import Engine, Session, load
    from .errors import EchoAvatarError
    from .hub import push_to_hub
    from .motion.kinematics import Motion

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # ONNX Runtime reports to its maker unless it is told not to

__version__ = "0.1.0"
__all__ = ["Animation", "EchoAvatarError", "Engine", "Motion", "Session", "animate", "load", "push_to_hub"]

_HOMES = {
    "Animation": ".animation",
    "EchoAvatarError": ".errors",
    "Motion": ".motion.kinematics",
    "animate": ".animation",
    "push_to_hub": ".hub",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, so that `echoavatar --help` loads little."""
    if name not in __all__:
        raise AttributeError(f"module 'echoavatar' has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, ".engine"), __name__), name)
