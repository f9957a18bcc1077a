"""The choices that decide what a set holds; its manifest keeps them, and a run is continued with the same only."""

import zlib
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from ..config import Config


class Options(Config):
    """Everything that changes the content of a set. Workers, pictures and progress are no part of it."""

    rig: Literal["unified", "native"] = Field(
        default="unified",
        description="unified: our 52 bones, feet settled; native: the recording's own skeleton",
    )
    fingers: Literal["auto", "keep", "all"] = Field(
        default="auto", description="hands to make anew: static or erratic ones, none, all"
    )
    sound: Literal["need", "any", "none"] = Field(
        default="need",
        description="need: no clip without sound; any: motion alone where it is missing; none: motion alone",
    )
    mirror: bool = Field(
        default=True, description="list a mirror image of each training clip; it takes no room"
    )
    seed: int = Field(default=0, description="of the fingers that are made anew")
    test_every: int | None = Field(
        default=None, ge=0, description="hold out each n-th recording by name; None: the published split"
    )
    length_tolerance: float = Field(
        default=0.1,
        gt=0,
        lt=1,
        description="share by which motion and sound may differ in length before a recording is refused",
    )
    shard_minutes: float = Field(default=20.0, gt=0, description="motion in a shard")
    body_model: Path | None = Field(
        default=None, description="the user's own SMPL-X model, for the joints of the speaker"
    )

    def binding(self) -> dict[str, Any]:
        """The choices that every clip of a set must share; the others decide what gets in, not how it is made."""
        free = {"shard_minutes", "sound", "length_tolerance", "test_every", "mirror"}
        return self.model_dump(mode="json", exclude=free)

    def digest(self) -> str:
        """A short mark of the binding choices."""
        return f"{zlib.crc32(repr(sorted(self.binding().items())).encode()):08x}"
