"""The options that decide what a set holds; its manifest stores them, and a run can only continue with the same."""

import zlib
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from echoavatar.config import Config


class Options(Config):
    """Options that change the content of a set, unlike workers, pictures and progress."""

    rig: Literal["unified", "native"] = Field(
        default="unified", description="unified: our 52 bones, feet settled; native: the recording's own skeleton"
    )
    fingers: Literal["auto", "keep", "all"] = Field(
        default="auto", description="hands that get new fingers: static and erratic ones, none, all"
    )
    sound: Literal["need", "any", "none"] = Field(
        default="need",
        description="need: no clip without sound; any: motion alone where it is missing; none: motion alone",
    )
    mirror: bool = Field(
        default=True, description="list a mirror image of each training clip; it takes no space on disk"
    )
    seed: int = Field(default=0, description="seed of new fingers")
    test_every: int | None = Field(
        default=None, ge=0, description="hold out every n-th recording by name; None: the published split"
    )
    length_tolerance: float = Field(
        default=0.1, gt=0, lt=1, description="largest relative difference in length of motion and sound"
    )
    shard_minutes: float = Field(default=20.0, gt=0, description="minutes of motion in a shard")
    body_model: Path | None = Field(
        default=None, description="the user's own SMPL-X model, for the speaker's joint positions"
    )

    def binding(self) -> dict[str, Any]:
        """The options that all clips of a set must share; the others only decide which clips it holds."""
        free = {"shard_minutes", "sound", "length_tolerance", "test_every", "mirror"}
        return self.model_dump(mode="json", exclude=free)

    def digest(self) -> str:
        """A short hash of the binding options."""
        return f"{zlib.crc32(repr(sorted(self.binding().items())).encode()):08x}"
