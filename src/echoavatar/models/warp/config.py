"""Sizes of the warp model and the shape of its brake curve; `recipe` says how it is trained."""

from pydantic import Field

from echoavatar.config import Config

from ..face import MelConfig


class WarpConfig(Config):
    """The face's mel encoder with two seconds of past, because a beat is predicted from earlier beats."""

    encoder: MelConfig = Field(default=MelConfig(width=96, past=15), description="audio encoder")
    sharpness: float = Field(
        default=1.5, gt=0, description="factor of the logits at inference: braking by half helps little"
    )
    eagerness: float = Field(default=0.5, description="added to the logits at inference: an extra dip costs little")
