"""Behind any voice agent: what its frameworks' adapters share. May import `server`, `client`, `engine` and below.

>>> stage = Stage(find_place("default"))       # or find_place("http://127.0.0.1:8765")
>>> await stage.start()
>>> await stage.say(pcm, rate=16_000)
>>> async for event in stage:                  # hops of motion and sound, when they are due
...     ...
"""

from .hop import Cut, Hop, Said
from .place import Place, find_place
from .stage import Stage
from .tools import StageTools

__all__ = ["Cut", "Hop", "Place", "Said", "Stage", "StageTools", "find_place"]
