"""A corpus: a folder with a `manifest.json` that lists every clip, and the clips in one of two forms.

Format 1 has a file a clip, `clips/*.npz`, each with its checksum; it is what `data rehearse` makes. Format 2 has
`shards/*.npy`, mapped into memory (`shards`); it is what `data prepare` makes, with mirror images that take no room.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.kinematics.mirror import is_symmetric, mirror_positions, mirror_quaternions
from echoavatar.timing import SAMPLES_PER_FRAME

from .clip import DOMAINS, PCM, Clip, open_clip
from .shards import Shard, ShardEntry, checksum

MIRROR = ".mirror"  # at the end of the name of a mirror image
SYMMETRIC_M = 0.05  # a person's own rig may differ so much between the sides and be mirrored still


class ClipEntry(Config):
    """One line of the manifest."""

    name: str = Field(description="name of the clip, also of its file under clips/")
    split: str = Field(description="train, val or test")
    frames: int = Field(gt=0, description="length at 30 frames per second")
    domains: dict[str, int] = Field(description="frames of silence, speech and music")
    sha256: str = Field(default="", description="checksum of the file; shards have their own")
    shard: int | None = Field(default=None, description="where the frames are: number of the shard")
    start: int = Field(default=0, ge=0, description="and the first frame in it")
    has_sound: bool = Field(default=True, description="False: motion alone, its sound reads as silence")
    mirrored: bool = Field(
        default=False, description="True: left and right of the clip are swapped as it is read"
    )
    events: dict[str, tuple[float, ...]] = Field(default_factory=dict, description="times in seconds by kind")
    labels: dict[str, str] = Field(default_factory=dict, description="speaker, style, genre: as published")


class Manifest(Config):
    """What is in a corpus and how it was made."""

    format: int = Field(default=1, description="version of this layout: 1 files, 2 shards")
    clips: tuple[ClipEntry, ...] = Field(description="every clip, sorted by name")
    shards: tuple[ShardEntry, ...] = Field(default=(), description="where the clips of format 2 are")
    skeletons: tuple[SkeletonConfig, ...] = Field(default=(), description="rigs; none: the humanoid")
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
        self._shards = [Shard(self.folder, entry) for entry in self.manifest.shards]

    def entries(self, split: str | None = None, *, has_mirrored: bool = True) -> list[ClipEntry]:
        """Manifest lines of one split, or of all, sorted by name; `has_mirrored=False` leaves mirror images out."""
        return [
            entry
            for entry in self.manifest.clips
            if split in (None, entry.split) and (has_mirrored or not entry.mirrored)
        ]

    def names(self, split: str | None = None, *, has_mirrored: bool = True) -> list[str]:
        """Clip names of one split, or of all."""
        return [entry.name for entry in self.entries(split, has_mirrored=has_mirrored)]

    def frames(self, split: str | None = None) -> int:
        """Total length in frames, mirror images not counted."""
        return sum(entry.frames for entry in self.entries(split, has_mirrored=False))

    @cached_property
    def skeleton(self) -> Skeleton:
        """The one rig of all clips.

        Raises:
            MotionError: the clips are on rigs of their own.
        """
        skeletons = self.manifest.skeletons
        if len(skeletons) > 1:
            raise MotionError(
                f"the clips of {self.folder} are on {len(skeletons)} rigs; one model needs one rig: prepare the set"
                " again with --rig unified"
            )
        return Skeleton(skeletons[0]) if skeletons else HUMANOID

    @property
    def can_mirror(self) -> bool:
        """Whether left and right of its rig are alike, so that swapping them gives a motion."""
        return can_mirror(self.skeleton)

    def skeleton_of(self, name: str) -> Skeleton:
        """The rig of one clip."""
        entry = self.entry(name)
        if entry.shard is None or not self.manifest.skeletons:
            return HUMANOID
        return Skeleton(self.manifest.skeletons[self.manifest.shards[entry.shard].skeleton])

    def entry(self, name: str) -> ClipEntry:
        """Manifest line of a clip; raises MotionError for a name that is not listed."""
        if name not in self._entries:
            raise MotionError(f"corpus {self.folder} has no clip {name!r}; only {len(self._entries)} others")
        return self._entries[name]

    def path(self, name: str) -> Path:
        """File of a clip of format 1; raises MotionError for a name that is not listed."""
        return clip_path(self.folder, self.entry(name).name)

    def load(self, name: str) -> Clip:
        """One clip, sound and motion."""
        entry = self.entry(name)
        if entry.shard is None:
            return Clip.load(self.path(name))
        motion, span = self.motion(name), slice(entry.start, entry.start + entry.frames)
        return Clip(
            name=name,
            audio=self.sound(name).astype(np.float32) / np.float32(PCM),
            rotations=motion.rotations,
            root=motion.root,
            domain=self._shards[entry.shard].domain[span],
            events=MappingProxyType({kind: np.array(times) for kind, times in entry.events.items()}),
            split=entry.split,
        )

    def clips(self, split: str | None = None) -> Iterator[Clip]:
        """All clips of a split, one in memory at a time."""
        return (self.load(name) for name in self.names(split))

    def motion(self, name: str) -> ClipMotion:
        """Rotations and root alone: a third of the bytes, or none where they are mapped into memory."""
        entry = self.entry(name)
        if entry.shard is None:
            with open_clip(self.path(name)) as stored:
                return ClipMotion(stored["rotations"], stored["root"])
        shard, span = self._shards[entry.shard], slice(entry.start, entry.start + entry.frames)
        motion = ClipMotion(shard.rotations[span], shard.root[span])
        return mirrored(self.skeleton_of(name), motion) if entry.mirrored else motion

    def sound(self, name: str) -> NDArray[np.int16]:
        """16-bit samples at 24 kHz; silence for a clip without sound."""
        entry = self.entry(name)
        if entry.shard is None:
            with open_clip(self.path(name)) as stored:
                return np.asarray(stored["audio"])
        if not entry.has_sound:
            return np.zeros(entry.frames * SAMPLES_PER_FRAME, np.int16)
        first = entry.start * SAMPLES_PER_FRAME
        return self._shards[entry.shard].audio[first : first + entry.frames * SAMPLES_PER_FRAME]

    def verify(self) -> None:
        """Raise MotionError for the first clip or shard whose file is missing or was changed since."""
        for entry in self.manifest.clips:
            if entry.shard is not None:
                continue
            path = self.path(entry.name)
            if not path.is_file():
                raise MotionError(f"corpus {self.folder}: {path.name} is missing; make the corpus again")
            if checksum(path) != entry.sha256:
                raise MotionError(f"corpus {self.folder}: {path.name} changed; make the corpus again")
        for shard in self._shards:
            shard.verify()


def can_mirror(skeleton: Skeleton) -> bool:
    """Whether a rig has named sides whose rest offsets are reflections of each other, to 5 cm."""
    return len(skeleton.config.mirror) == skeleton.joints and is_symmetric(skeleton, SYMMETRIC_M)


def mirrored(skeleton: Skeleton, motion: ClipMotion) -> ClipMotion:
    """Left and right swapped: signs and places only, so it is exact."""
    rotations = mirror_quaternions(skeleton, torch.from_numpy(np.array(motion.rotations)))
    return ClipMotion(rotations.numpy(), mirror_positions(torch.from_numpy(np.array(motion.root))).numpy())


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
    return save_manifest(
        folder, Manifest(format=1, clips=tuple(_entry(path) for path in paths), info=dict(info or {}))
    )


def save_manifest(folder: Path | str, manifest: Manifest) -> Corpus:
    """Write `manifest.json`, whole or not at all; fields that say nothing are left out."""
    folder = Path(folder)
    content = manifest.model_dump(exclude_defaults=True, mode="json") | {"format": manifest.format}
    partial = folder / "manifest.json.part"
    partial.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(folder / "manifest.json")
    return Corpus(folder)


def _entry(path: Path) -> ClipEntry:
    with open_clip(path) as stored:
        domain = stored["domain"]
        return ClipEntry(
            name=path.stem,
            split=str(stored["split"]),
            frames=int(stored["root"].shape[0]),
            domains=count_domains(domain),
            sha256=checksum(path),
        )


def count_domains(domain: NDArray[np.uint8]) -> dict[str, int]:
    """Frames of silence, speech and music."""
    return {label: int((domain == i).sum()) for i, label in enumerate(DOMAINS)}
