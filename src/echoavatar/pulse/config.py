"""Sizes of the pulse model, and how decided it is; how it is trained is in `recipe`."""

from pydantic import Field

from ..config import Config
from ..face import MelConfig


class PulseConfig(Config):
    """The mel encoder that the face has too, with two seconds of past: a beat is told by those before it."""

    encoder: MelConfig = Field(default=MelConfig(width=96, past=15), description="what it hears with")
    sharpness: float = Field(
        default=1.5,
        gt=0,
        description="by which logits are multiplied when used: half a dip in time helps little",
    )
    eagerness: float = Field(default=0.5, description="added to them then: a dip too many costs little")
