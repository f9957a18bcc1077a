"""A corpus: a folder with clips in one of two formats and a `manifest.json` that lists them.

Format 1, made by `data rehearse`, has one file per clip, `clips/*.npz`, with its checksum. Format 2, made by `data
prepare`, has shards and mirror images that take no space on disk.

A shard holds many clips end to end in up to four flat files `shards/*.npy` that are memory-mapped: `rotations`
(n, j, 4) float32, `root` (n, 3) float32, `domain` (n,) uint8 and, for clips with sound, `audio` (800 n,) int16 at
24 kHz. Frames `start` to `start + frames` belong to one clip. The manifest holds the checksum of every file; a shard is
complete once the manifest lists it.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder, whole_file, write_whole

from .clip import DOMAINS, PCM, Clip, is_symmetric, mirror_positions, mirror_quaternions, open_clip, stored_labels

TYPES = {"rotations": np.float32, "root": np.float32, "domain": np.uint8, "audio": np.int16}


class ShardEntry(Config):
    """One shard as the manifest lists it."""

    name: str = Field(description="prefix of its file names")
    frames: int = Field(gt=0, description="length at 30 frames per second, all clips together")
    skeleton: int = Field(default=0, ge=0, description="index of its rig in the manifest's skeletons")
    sha256: dict[str, str] = Field(description="checksum of each array's file")


class Shard:
    """The arrays of a shard by name (`TYPES`), mapped on first access.

    Access raises MotionError if the file is missing, damaged or of another shape.
    """

    def __init__(self, folder: Path, entry: ShardEntry) -> None:
        self.folder, self.entry = folder, entry
        self._mapped: dict[str, NDArray[Any]] = {}

    def __getitem__(self, array: str) -> NDArray[Any]:
        if array not in self._mapped:
            self._mapped[array] = self._map(array)
        return self._mapped[array]

    def verify(self) -> None:
        """Raise MotionError for the first file that is missing or has changed."""
        for array, wanted in self.entry.sha256.items():
            _verify(shard_path(self.folder, self.entry.name, array), wanted)

    def _map(self, array: str) -> NDArray[Any]:
        path = shard_path(self.folder, self.entry.name, array)
        try:
            # copy on write, because torch needs writable memory
            values: NDArray[Any] = np.load(path, mmap_mode="c", allow_pickle=False)
        except FileNotFoundError as error:
            raise MotionError(f"shard {path} is missing; prepare the set again") from error
        except (OSError, ValueError, EOFError) as error:
            raise MotionError(f"shard {path} is damaged ({error}); prepare the set again") from error
        wanted = self.entry.frames * (SAMPLES_PER_FRAME if array == "audio" else 1)
        if values.dtype != TYPES[array] or len(values) != wanted:
            raise MotionError(
                f"shard {path} holds {len(values)} rows of {values.dtype}, the manifest says {wanted} of"
                f" {np.dtype(TYPES[array])}; prepare the set again"
            )
        return values


def write_shard(folder: Path, name: str, arrays: Mapping[str, NDArray[Any]], *, skeleton: int = 0) -> ShardEntry:
    """Write the arrays of a shard, each file completely or not at all.

    Raises MotionError if a file cannot be written.
    """
    sums = {}
    for array, values in arrays.items():
        path = shard_path(folder, name, array)
        make_output_folder(path.parent, error=MotionError)
        with whole_file(path, error=MotionError) as partial:
            with partial.open("wb") as file:
                np.save(file, np.ascontiguousarray(values, TYPES[array]))
            sums[array] = checksum(partial)
    return ShardEntry(name=name, frames=len(arrays["root"]), skeleton=skeleton, sha256=sums)


def shard_path(folder: Path, name: str, array: str) -> Path:
    """Path of one array of a shard in a set."""
    return folder / "shards" / f"{name}.{array}.npy"


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _verify(path: Path, wanted: str) -> None:
    if not path.is_file():
        raise MotionError(f"{path} is missing; make the set again")
    if checksum(path) != wanted:
        raise MotionError(f"{path} changed; make the set again")


MIRROR = ".mirror"  # suffix of a mirror image's name
SYMMETRIC_M = 0.05  # a rig whose sides differ by at most this much can be mirrored

MANIFEST_BYTES = 1 << 28  # of the list of a set's clips, or of a receipt for each
MANIFEST_VALUES = 1 << 24  # 1,000 hours of clips have some five million times of beats and stresses


class ClipEntry(Config):
    """One clip as the manifest lists it."""

    name: str = Field(description="name of the clip, also of its file under clips/")
    split: str = Field(description="train, val or test")
    frames: int = Field(gt=0, description="length at 30 frames per second")
    domains: dict[str, int] = Field(description="frames of silence, speech and music")
    sha256: str = Field(default="", description="checksum of the clip's file (format 1)")
    shard: int | None = Field(default=None, description="number of the shard with the frames (format 2)")
    start: int = Field(default=0, ge=0, description="first frame in the shard")
    has_sound: bool = Field(default=True, description="False: motion only, the sound reads as silence")
    mirrored: bool = Field(default=False, description="True: left and right are swapped on reading")
    events: dict[str, tuple[float, ...]] = Field(default_factory=dict, description="times in seconds by kind")
    labels: dict[str, str] = Field(default_factory=dict, description="speaker, style, genre, as published")


class Manifest(Config):
    """The clips of a corpus and how it was made."""

    format: int = Field(default=1, description="version of this layout: 1 files, 2 shards")
    clips: tuple[ClipEntry, ...] = Field(description="every clip, sorted by name")
    shards: tuple[ShardEntry, ...] = Field(default=(), description="shards of format 2")
    skeletons: tuple[SkeletonConfig, ...] = Field(default=(), description="rigs; none: the humanoid")
    info: dict[str, Any] = Field(default_factory=dict, description="how it was made: seed, hours, version")


class ClipMotion(NamedTuple):
    """Motion without sound."""

    rotations: NDArray[np.float32]
    root: NDArray[np.float32]


class Corpus:
    """Clips on disk, read on access."""

    def __init__(self, folder: Path | str) -> None:
        """Raises MotionError if the folder holds no readable manifest."""
        self.folder = Path(folder)
        path = self.folder / "manifest.json"
        try:
            stored = read_object_file(path, most=MANIFEST_BYTES, most_values=MANIFEST_VALUES)
            self.manifest = Manifest.model_validate(stored)
        except OSError as error:
            raise MotionError(
                f"{self.folder} is not a corpus: manifest.json is missing; make one with `echoavatar data rehearse`"
            ) from error
        except (ValidationError, EchoAvatarError) as error:
            raise MotionError(f"{path} is damaged; make the corpus again") from error
        self._entries = {entry.name: entry for entry in self.manifest.clips}
        self._shards = [Shard(self.folder, entry) for entry in self.manifest.shards]

    def entries(self, split: str | None = None, *, has_mirrored: bool = True) -> list[ClipEntry]:
        """Entries of one split or of all, sorted by name; `has_mirrored=False` leaves mirror images out."""
        return [
            entry
            for entry in self.manifest.clips
            if split in (None, entry.split) and (has_mirrored or not entry.mirrored)
        ]

    def names(self, split: str | None = None, *, has_mirrored: bool = True) -> list[str]:
        """Names of the clips of one split or of all."""
        return [entry.name for entry in self.entries(split, has_mirrored=has_mirrored)]

    def frames(self, split: str | None = None) -> int:
        """Total length in frames, without mirror images."""
        return sum(entry.frames for entry in self.entries(split, has_mirrored=False))

    @cached_property
    def skeleton(self) -> Skeleton:
        """The rig of all clips. Raises MotionError if the clips have different rigs."""
        skeletons = self.manifest.skeletons
        if len(skeletons) > 1:
            raise MotionError(
                f"the clips of {self.folder} have {len(skeletons)} rigs, a model needs a single one; prepare the set"
                " again with --rig unified"
            )
        return Skeleton(skeletons[0]) if skeletons else HUMANOID

    @property
    def fingerprint(self) -> str:
        """One checksum over all clips or shards; two corpora with the same one hold the same data."""
        parts = [f"{entry.name} {entry.sha256}" for entry in self.manifest.clips]
        parts += [str(entry.model_dump()) for entry in self.manifest.shards]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    @property
    def can_mirror(self) -> bool:
        """Whether the rig is symmetric, so that clips can be mirrored."""
        return can_mirror(self.skeleton)

    def skeleton_of(self, name: str) -> Skeleton:
        """The rig of one clip."""
        entry = self.entry(name)
        if entry.shard is None or not self.manifest.skeletons:
            return HUMANOID
        return Skeleton(self.manifest.skeletons[self.manifest.shards[entry.shard].skeleton])

    def entry(self, name: str) -> ClipEntry:
        """The entry of a clip; raises MotionError for a name that is not listed."""
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
            domain=self._shards[entry.shard]["domain"][span],
            events=MappingProxyType({kind: np.array(times) for kind, times in entry.events.items()}),
            split=entry.split,
            labels=entry.labels,
        )

    def clips(self, split: str | None = None) -> Iterator[Clip]:
        """All clips of a split, one in memory at a time."""
        return (self.load(name) for name in self.names(split))

    def motion(self, name: str) -> ClipMotion:
        """Rotations and root of a clip, without reading its sound."""
        entry = self.entry(name)
        if entry.shard is None:
            with open_clip(self.path(name)) as stored:
                return ClipMotion(stored["rotations"], stored["root"])
        shard, span = self._shards[entry.shard], slice(entry.start, entry.start + entry.frames)
        motion = ClipMotion(shard["rotations"][span], shard["root"][span])
        return mirrored(self.skeleton_of(name), motion) if entry.mirrored else motion

    def motions(self, split: str) -> list[ClipMotion]:
        """The motion of every clip of a split, without mirror images."""
        return [self.motion(name) for name in self.names(split, has_mirrored=False)]

    def sound(self, name: str) -> NDArray[np.int16]:
        """16-bit samples at 24 kHz; zeros for a clip without sound."""
        entry = self.entry(name)
        if entry.shard is None:
            with open_clip(self.path(name)) as stored:
                return np.asarray(stored["audio"])
        if not entry.has_sound:
            return np.zeros(entry.frames * SAMPLES_PER_FRAME, np.int16)
        first = entry.start * SAMPLES_PER_FRAME
        return self._shards[entry.shard]["audio"][first : first + entry.frames * SAMPLES_PER_FRAME]

    def verify(self) -> None:
        """Raise MotionError for the first clip or shard whose file is missing or has changed."""
        for entry in self.manifest.clips:
            if entry.shard is None:
                _verify(self.path(entry.name), entry.sha256)
        for shard in self._shards:
            shard.verify()


def can_mirror(skeleton: Skeleton) -> bool:
    """Whether a rig has mirror pairs whose rest offsets are reflections of each other, within 5 cm."""
    return len(skeleton.config.mirror) == skeleton.joints and is_symmetric(skeleton, SYMMETRIC_M)


def mirrored(skeleton: Skeleton, motion: ClipMotion) -> ClipMotion:
    """Swap left and right; exact, because only signs and joint order change."""
    rotations = mirror_quaternions(skeleton, torch.from_numpy(np.array(motion.rotations)))
    return ClipMotion(rotations.numpy(), mirror_positions(torch.from_numpy(np.array(motion.root))).numpy())


def clip_path(folder: Path | str, name: str) -> Path:
    """Path of a clip's file in a corpus."""
    return Path(folder) / "clips" / f"{name}.npz"


def write_manifest(folder: Path | str, info: Mapping[str, Any] | None = None) -> Corpus:
    """Write the manifest of a folder's clips."""
    folder = Path(folder)
    paths = sorted((folder / "clips").glob("*.npz"))
    return save_manifest(folder, Manifest(format=1, clips=tuple(_entry(path) for path in paths), info=dict(info or {})))


def save_manifest(folder: Path | str, manifest: Manifest) -> Corpus:
    """Write `manifest.json`, completely or not at all; fields with default values are left out."""
    folder = Path(folder)
    content = manifest.model_dump(exclude_defaults=True, mode="json") | {"format": manifest.format}
    write_whole(folder / "manifest.json", json.dumps(content, indent=1, sort_keys=True) + "\n")
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
            labels=stored_labels(stored),
        )


def count_domains(domain: NDArray[np.uint8]) -> dict[str, int]:
    """Frames of silence, speech and music."""
    return {label: int((domain == i).sum()) for i, label in enumerate(DOMAINS)}
