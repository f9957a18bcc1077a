"""A corpus: a folder with `clips/*.npz` and `manifest.json`, which lists every clip with its checksum."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import MotionError

from .clip import DOMAINS, Clip, open_clip


class ClipEntry(Config):
    """One line of the manifest."""

    name: str = Field(description="name of the clip, also of its file under clips/")
    split: str = Field(description="train or test")
    frames: int = Field(gt=0, description="length at 30 frames per second")
    domains: dict[str, int] = Field(description="frames of silence, speech and music")
    sha256: str = Field(description="checksum of the file")


class Manifest(Config):
    """What is in a corpus and how it was made."""

    format: int = Field(1, description="version of this layout")
    clips: tuple[ClipEntry, ...] = Field(description="every clip, sorted by name")
    info: dict[str, Any] = Field(default_factory=dict, description="how it was made: seed, hours, version")


class ClipMotion(NamedTuple):
    """The motion alone, for work that needs no sound."""

    rotations: NDArray[np.float32]
    root: NDArray[np.float32]


class Corpus:
    """Clips on disk; only what is asked for is read."""

    def __init__(self, folder: Path | str) -> None:
        """Raises MotionError when the folder holds no readable manifest."""
        self.folder = Path(folder)
        path = self.folder / "manifest.json"
        try:
            self.manifest = Manifest.model_validate_json(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise MotionError(
                f"{self.folder} is no corpus: manifest.json is missing; make one: `echoavatar data rehearse`"
            ) from error
        except (ValidationError, UnicodeDecodeError) as error:
            raise MotionError(f"{path} is damaged; make the corpus again") from error
        self._entries = {entry.name: entry for entry in self.manifest.clips}

    def entries(self, split: str | None = None) -> list[ClipEntry]:
        """Manifest lines of one split, or of all, sorted by name."""
        return [entry for entry in self.manifest.clips if split in (None, entry.split)]

    def names(self, split: str | None = None) -> list[str]:
        """Clip names of one split, or of all."""
        return [entry.name for entry in self.entries(split)]

    def frames(self, split: str | None = None) -> int:
        """Total length in frames."""
        return sum(entry.frames for entry in self.entries(split))

    def path(self, name: str) -> Path:
        """File of a clip; raises MotionError for a name that is not listed."""
        if name not in self._entries:
            raise MotionError(f"corpus {self.folder} has no clip {name!r}; only {len(self._entries)} others")
        return clip_path(self.folder, name)

    def load(self, name: str) -> Clip:
        """One clip, sound and motion."""
        return Clip.load(self.path(name))

    def clips(self, split: str | None = None) -> Iterator[Clip]:
        """All clips of a split, one in memory at a time."""
        return (self.load(name) for name in self.names(split))

    def motion(self, name: str) -> ClipMotion:
        """Rotations and root alone: a third of the bytes."""
        with open_clip(self.path(name)) as stored:
            return ClipMotion(stored["rotations"], stored["root"])

    def verify(self) -> None:
        """Raise MotionError for the first clip whose file is missing or was changed since."""
        for entry in self.manifest.clips:
            path = self.path(entry.name)
            if not path.is_file():
                raise MotionError(f"corpus {self.folder}: {path.name} is missing; make the corpus again")
            if _checksum(path) != entry.sha256:
                raise MotionError(f"corpus {self.folder}: {path.name} changed; make the corpus again")


def clip_path(folder: Path | str, name: str) -> Path:
    """Where a clip of this name lies in a corpus."""
    return Path(folder) / "clips" / f"{name}.npz"


def write_manifest(
    folder: Path | str, info: Mapping[str, Any] | None = None, names: Sequence[str] | None = None
) -> Corpus:
    """List the clips of a folder (or only the named ones) and write `manifest.json`, whole or not at all."""
    folder = Path(folder)
    paths = (
        sorted((folder / "clips").glob("*.npz"))
        if names is None
        else [clip_path(folder, name) for name in sorted(names)]
    )
    manifest = Manifest(format=1, clips=tuple(_entry(path) for path in paths), info=dict(info or {}))
    partial = folder / "manifest.json.part"
    partial.write_text(json.dumps(manifest.model_dump(), indent=1, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(folder / "manifest.json")
    return Corpus(folder)


def _entry(path: Path) -> ClipEntry:
    with open_clip(path) as stored:
        domain = stored["domain"]
        return ClipEntry(
            name=path.stem,
            split=str(stored["split"]),
            frames=int(stored["root"].shape[0]),
            domains={label: int((domain == i).sum()) for i, label in enumerate(DOMAINS)},
            sha256=_checksum(path),
        )


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
