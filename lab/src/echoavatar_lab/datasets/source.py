"""Descriptions of datasets: recordings with files, split and labels, terms of use; and the options of a set."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from echoavatar.config import Config

Domain = Literal["speech", "music"]


class Terms(Config):
    """Origin and licence of a dataset; stored in the manifest of every set made of it."""

    title: str = Field(description="name of the dataset")
    origin: str = Field(description="where it is published")
    licence: str = Field(description="its licence, in one line")
    may_ship: str = Field(description="whether the set and weights trained on it may be passed on")
    cite: str = Field(default="", description="the citation that its authors ask for")


@dataclass(frozen=True)
class Recording:
    """One recording: its files and what the dataset says about it.

    Attributes:
        name: file-safe, unique in its dataset.
        motion: BVH, SMPL-X npz, or LDA's pickled table.
        sound: the sound file that belongs to it, even if it is missing; None for motion without sound.
        domain: kind of the sound.
        split: "train", "val" or "test" as published; "" if there is no published split.
        labels: speaker, style, genre.
        rates: frame rates at which the dataset is published; empty if any is fine.
        rig: a BVH with the bone lengths of motion that has none itself.
    """

    name: str
    motion: Path
    sound: Path | None
    domain: Domain = "speech"
    split: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    rates: tuple[float, ...] = ()
    rig: Path | None = None


class LeftOut(NamedTuple):
    """A recording that is not used, and why."""

    name: str
    why: str


class Survey(NamedTuple):
    """The recordings that were found in a folder, and those that were not or are not used."""

    terms: Terms
    recordings: Sequence[Recording]
    missing: Sequence[str] = ()  # what this copy lacks of the published dataset, one line each
    left_out: Sequence[LeftOut] = ()
    split_from: str = ""  # description of the split's origin


def with_splits(recordings: Sequence[Recording], test_every: int | None) -> list[Recording]:
    """Recordings that all have a split: the published one, or every n-th by name for testing (0: none).

    Without `test_every`, every tenth of the recordings without a published split is held out.
    """
    every = 10 if test_every is None else test_every
    return [
        recording
        if test_every is None and recording.split
        else replace(recording, split="test" if every and number % every == every - 1 else "train")
        for number, recording in enumerate(sorted(recordings, key=lambda recording: recording.name))
    ]


def files_below(folder: Path, *suffixes: str) -> list[Path]:
    """Files with these suffixes (lower case) anywhere below a folder, sorted; hidden files are skipped."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in suffixes
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


class SetOptions(Config):
    """Options that change the content of a set, unlike workers, pictures and progress."""

    rig: Literal["unified", "native"] = Field(
        default="unified", description="unified: our 52 bones, planted feet held still; native: the recording's own rig"
    )
    fingers: Literal["auto", "keep", "all"] = Field(
        default="auto", description="hands that get new fingers: auto (static and erratic ones), keep (none), all"
    )
    sound: Literal["need", "any", "none"] = Field(
        default="need", description="need: refuse motion without sound; any: accept it; none: leave out all sound"
    )
    mirror: bool = Field(default=True, description="list a mirror image of each training clip; takes no space")
    seed: int = Field(default=0, description="seed of new fingers")
    test_every: int | None = Field(default=None, ge=0, description="hold out every n-th recording by name, 0 none")
    length_tolerance: float = Field(
        default=0.1,
        gt=0,
        lt=1,
        description="largest relative difference in length of motion and sound; the longer is cut",
    )
    shard_minutes: float = Field(default=20.0, gt=0, description="minutes of motion in a shard")
    joints: dict[str, str | None] | None = Field(
        default=None, description="the user's map from bones to joints of the recordings; None: they are found"
    )
    body_model: Path | None = Field(default=None, description="BEAT2: SMPLX_NEUTRAL_2020.npz, for the speaker's joints")

    def binding(self) -> dict[str, Any]:
        """The options that all clips of a set must share; the others only decide which clips it holds."""
        free = {"shard_minutes", "sound", "length_tolerance", "test_every", "mirror"}
        return self.model_dump(mode="json", exclude=free)

    def digest(self) -> str:
        """A short hash of the binding options."""
        return f"{zlib.crc32(repr(sorted(self.binding().items())).encode()):08x}"
