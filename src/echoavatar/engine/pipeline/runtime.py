"""How the pipeline runs a bundle's models: settings beside the checkpoints, in `runtime.json`.

A bundle without the file gets the defaults, which are those of our own bundles.
"""

from pathlib import Path

from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.limits import CONFIG_BYTES, check_file
from echoavatar.motion.stages.post import SWITCHES

from .foreign_rig import RigConfig
from .time_warp import WARP

FILE = "runtime.json"


class Runtime(Config):
    """Run-time settings of a bundle."""

    level_control: bool = Field(default=True, description="whether sound is brought to one loudness first")
    silent_temperature: float = Field(
        default=0.3, ge=0, description="factor of the temperature in silence (ours: 0.3, paper: 1)"
    )
    restless_temperature: float = Field(
        default=1.5,
        gt=0,
        description="factor of the temperature once the body has been still for 1.6 s of sound (paper: 1)",
    )
    lead_in_s: float = Field(
        default=2.0,
        ge=0,
        le=60,
        description="seconds of silence in the warm start of a session (rounded up to chunks; paper: 0)",
    )
    stages: tuple[str, ...] = Field(
        default=(WARP, *SWITCHES), description="stages behind the decoder, unless asked for"
    )
    rig: RigConfig | None = Field(
        default=None, description="how the features of a foreign rig differ from ours; None: our rig"
    )

    def save(self, folder: Path) -> None:
        """Write `runtime.json`."""
        partial = folder / f"{FILE}.partial"
        partial.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")
        partial.replace(folder / FILE)

    @classmethod
    def load(cls, folder: Path) -> "Runtime":
        """Read `runtime.json` if the folder has one.

        Raises:
            CheckpointError: the file is damaged.
        """
        path = folder / FILE
        if not path.exists():
            return cls()
        check_file(path, CONFIG_BYTES, CheckpointError)
        try:
            return cls.model_validate_json(path.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(str(part) for part in first["loc"]) or "the whole file"
            raise CheckpointError(f"{path}: {field}: {first['msg']}; import or copy the bundle again") from error
