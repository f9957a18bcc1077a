"""How the pipeline runs a bundle's models: settings beside the checkpoints, in `runtime.json`.

A bundle without the file gets the defaults, which are those of our own bundles. Everything that we add to the paper's
method is in `ADDITIONS` and can be switched by name. `Runtime.chosen("paper")` has none of it: codes are drawn and
decoded, the paper's cylinder keeps the hands off the body, and files have 60 frames per second. `bare` leaves out the
cylinder and the 60 fps, too. Scores are always taken at the 30 fps that are decoded.
"""

from pathlib import Path

from pydantic import Field

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.stages.post import SWITCHES
from echoavatar.stored import read_config
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.whole_file import write_whole

from .foreign_rig import RigConfig

FILE = "runtime.json"
PAPER_FPS = 60.0  # paper, Settings: 30 frames per second, "subsequently interpolated to 60 FPS for final rendering"
SESSION = ("settling", "home", "idle", "expression", "blinks", "listening", "gaze", "overlays")  # added by sessions
NUMBERS = {"level": ("level_control", False), "lead-in": ("lead_in_s", 0.0)}  # addition -> field, the paper's value
ADDITIONS = (*NUMBERS, *SWITCHES, *SESSION)


class Runtime(Config):
    """Run-time settings of a bundle."""

    level_control: bool = Field(default=True, description="whether sound is brought to one loudness first")
    lead_in_s: float = Field(
        default=2.0,
        ge=0,
        le=60,
        description="seconds of silence in the warm start of a session (rounded up to chunks; paper: 0)",
    )
    stages: tuple[str, ...] = Field(default=SWITCHES, description="stages behind the decoder, unless others are named")
    session: tuple[str, ...] = Field(
        default=SESSION,
        description="what a session adds: settling after music, the way home after a dance, idle motion with breath, "
        "moods of the face, blinks, nods and a turned head while the user speaks, eye contact with glances away, the "
        "part of an action that codes cannot express",
    )
    cylinder: bool = Field(default=False, description="whether the paper's cylinder keeps hands off the body")
    fps: float = Field(
        default=FRAME_RATE_HZ, ge=1, le=1000, description="frames per second of files, interpolated (paper: 60)"
    )
    rig: RigConfig | None = Field(default=None, description="how a foreign rig's features differ; None: our rig")

    @property
    def additions(self) -> tuple[str, ...]:
        """Our additions that are on, in the order of `ADDITIONS`."""
        numbers = [name for name, (field, paper) in NUMBERS.items() if getattr(self, field) != paper]
        on = {*numbers, *self.stages, *self.session}
        return tuple(name for name in ADDITIONS if name in on)

    @property
    def label(self) -> str:
        """`bare`, `paper`, `default` (all of ours) or the names of the additions that are on; for headers."""
        on = self.additions
        if on:
            return "default" if on == ADDITIONS else ",".join(on)
        return "paper" if self.cylinder or self.rig else "bare"

    def chosen(self, name: str) -> "Runtime":
        """These settings run otherwise: `default` changes nothing, `paper` leaves out everything of ours, `bare`
        the paper's cylinder and 60 fps too.

        Any other name lists the additions to keep, such as `ground,feet`; the rest is as in the paper. A switched-off
        setting that is named gets our bundles' value. A foreign rig's adapter and cylinder always stay. Raises
        EchoAvatarError if there is no addition of that name.
        """
        if name == "default":
            return self
        kept = () if name in ("paper", "bare") else tuple(part.strip() for part in name.split(","))
        if unknown := [part for part in kept if part not in ADDITIONS]:
            known = ", ".join(ADDITIONS)
            raise EchoAvatarError(f"no runtime {unknown[0]!r}: give paper, default, bare, or some of {known}")
        ours, changed = Runtime(), dict[str, object]()
        for part, (field, paper) in NUMBERS.items():
            own = getattr(self, field)
            changed[field] = paper if part not in kept else own if own != paper else getattr(ours, field)
        changed["stages"] = tuple(stage for stage in ours.stages if stage in kept)
        changed["session"] = tuple(part for part in SESSION if part in kept)
        changed["fps"] = self.fps if name == "bare" else PAPER_FPS
        changed["cylinder"] = name != "bare" and "hands" not in kept and self.rig is None
        return self.model_copy(update=changed)

    def save(self, folder: Path) -> None:
        """Write `runtime.json`."""
        write_whole(folder / FILE, self.model_dump_json(indent=1) + "\n")

    @classmethod
    def load(cls, folder: Path, *, is_leveled: bool = True) -> "Runtime":
        """Read `runtime.json` if the folder has one; without, sound is levelled if the generator's was (`is_leveled`).

        Raises CheckpointError if the file is damaged.
        """
        if not (folder / FILE).exists():
            return cls(level_control=is_leveled)
        return read_config(folder, cls, FILE)
