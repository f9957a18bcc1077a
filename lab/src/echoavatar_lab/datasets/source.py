"""Descriptions of datasets: recordings with files, split and labels, and terms of use.

A layout is a module with `TERMS` and `survey(folder) -> Survey`; `LAYOUTS` maps the command line's names to modules.
"""

import fnmatch
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import Field

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError

Domain = Literal["speech", "music"]
LAYOUTS = {"zeroeggs": "zeroeggs", "motorica": "motorica", "beat2": "beat2", "bandai": "bandai", "bvh": "folder"}


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
    """What was found in a folder."""

    terms: Terms
    recordings: Sequence[Recording]
    missing: Sequence[str] = ()  # what this copy lacks of the published dataset, one line each
    left_out: Sequence[LeftOut] = ()
    split_from: str = ""  # description of the split's origin


def survey_of(
    kind: str, folder: Path, *, only: Sequence[str] = (), speakers: Sequence[str] = (), has_additional: bool = False
) -> Survey:
    """Find a dataset's recordings.

    Args:
        kind: one of `LAYOUTS`.
        folder: the user's copy: the folder with the files, or one above it.
        only: glob patterns of names; other recordings are left out.
        speakers: numbers or names of speakers; others are left out.
        has_additional: include recordings outside the standard part of the dataset.

    Raises:
        EchoAvatarError: the folder does not exist or holds nothing of this dataset.
    """
    if not folder.is_dir():
        raise EchoAvatarError(f"{folder} is not a folder; pass the folder of your copy of the dataset")
    survey: Callable[..., Survey] = import_module(f".{LAYOUTS[kind]}", __package__).survey
    found = survey(folder, has_additional=has_additional) if kind == "beat2" else survey(folder)
    wanted, left_out = [], list(found.left_out)
    for recording in found.recordings:
        if only and not any(fnmatch.fnmatch(recording.name, glob) for glob in only):
            left_out.append(LeftOut(recording.name, "not among --only"))
        elif speakers and not _speaks(recording, speakers):
            left_out.append(LeftOut(recording.name, "not among --speakers"))
        else:
            wanted.append(recording)
    if not wanted:
        everything = f", all {len(left_out)} left out: {left_out[0].why}" if left_out else ""
        missing = f"; {'; '.join(found.missing)}" if found.missing else ""
        raise EchoAvatarError(f"no recording of {kind} to prepare in {folder}{everything}{missing}")
    return found._replace(recordings=tuple(wanted), left_out=tuple(left_out))


def with_splits(recordings: Sequence[Recording], test_every: int | None) -> list[Recording]:
    """Recordings that all have a split: the published one, or every n-th by name for testing (0: none).

    Without `test_every`, every tenth of the recordings without a published split is held out.
    """
    ordered = sorted(recordings, key=lambda recording: recording.name)
    if test_every is None and all(recording.split for recording in ordered):
        return ordered
    every = 10 if test_every is None else test_every
    keep = test_every is None
    return [
        recording
        if keep and recording.split
        else replace(recording, split="test" if every and number % every == every - 1 else "train")
        for number, recording in enumerate(ordered)
    ]


def _speaks(recording: Recording, speakers: Sequence[str]) -> bool:
    own = {recording.labels.get("speaker", ""), recording.labels.get("speaker_name", "")} - {""}
    return bool(own & set(speakers))


def files_below(folder: Path, *suffixes: str) -> list[Path]:
    """Files with these suffixes (lower case) anywhere below a folder, sorted; hidden files are skipped."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in suffixes
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )
