"""When the body should brake: stressed syllables and beats, heard from streaming sound as one curve of 0 to 1.

Not in the paper, whose generator must be in time by itself. May import `face` (its mel encoder), `audio`, `data`,
`training` (only `train`), `nn`, `checkpoint` and below.
"""

from .config import PulseConfig
from .model import PulseModel, PulseState

__all__ = ["PulseConfig", "PulseModel", "PulseState"]
