"""Merges sets into one: the paper's mixture of speech and dance from sets that were prepared one by one.

Clips keep name, split, events and labels. Shards are linked where the file system allows it, else copied, so a merged
set takes no space beside its parts; clips of a rehearsal corpus (format 1) are packed into shards. The manifest lists
the parts with their terms of use; the terms of all parts apply together.
"""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.progress import Progress, watched

from .clip import open_clip
from .corpus import MIRROR, ClipEntry, Corpus, Manifest, ShardEntry, can_mirror, save_manifest, shard_path, write_shard

SHARD_FRAMES = 20 * 60 * FRAME_RATE_HZ


def merge(folders: Sequence[Path], folder: Path, *, progress: Progress | None = None) -> Corpus:
    """Write a set in `folder` that holds the clips of all of `folders`.

    Raises:
        MotionError: a folder is no set, two sets have a clip of one name or other rigs, or `folder` holds something.
    """
    parts = [Corpus(one) for one in folders]
    _want_fit(parts)
    if folder.exists() and any(folder.iterdir()):
        raise MotionError(f"{folder} holds something already; choose another -o, or delete it")
    clips: list[ClipEntry] = []
    shards: list[ShardEntry] = []
    for part in watched(parts, progress):
        added, written = _packed(part, folder, len(shards))
        shards += written
        clips += added
    skeletons = parts[0].manifest.skeletons
    names = tuple(sorted(clips, key=lambda entry: entry.name))
    make_output_folder(folder)
    return save_manifest(
        folder, Manifest(format=2, clips=names, shards=tuple(shards), skeletons=skeletons, info=_info(parts))
    )


def _want_fit(parts: Sequence[Corpus]) -> None:
    seen: dict[str, Path] = {}
    for part in parts:
        if part.skeleton.config != parts[0].skeleton.config:
            raise MotionError(
                f"{part.folder} is on another rig than {parts[0].folder}; prepare both with --rig unified"
            )
        for name in part.names(has_mirrored=False):
            if name in seen:
                raise MotionError(
                    f"{part.folder} and {seen[name]} both have a clip {name!r}; prepare one of them without it (--only)"
                )
            seen[name] = part.folder


def _packed(part: Corpus, folder: Path, first: int) -> tuple[list[ClipEntry], list[ShardEntry]]:
    """The entries and shards of one set as the merged set lists them; its shards are numbered from `first` on."""
    if part.manifest.format == 1:
        return _packed_files(part, folder, first)
    shards = []
    for number, shard in enumerate(part.manifest.shards, first):
        for array in shard.sha256:
            _link(shard_path(part.folder, shard.name, array), shard_path(folder, f"{number:05d}", array))
        shards.append(shard.model_copy(update={"name": f"{number:05d}"}))
    moved = [entry.model_copy(update={"shard": first + (entry.shard or 0)}) for entry in part.entries()]
    return moved, shards


def _packed_files(part: Corpus, folder: Path, first: int) -> tuple[list[ClipEntry], list[ShardEntry]]:
    """Clips in files of their own, packed into shards; training clips get mirror images."""
    entries: list[ClipEntry] = []
    shards: list[ShardEntry] = []
    waiting: list[dict[str, Any]] = []

    def flush() -> None:
        if waiting:
            arrays = {key: np.concatenate([clip[key] for clip in waiting]) for key in waiting[0]}
            shards.append(write_shard(folder, f"{first + len(shards):05d}", arrays))
            waiting.clear()

    for entry in part.entries():
        start = sum(len(clip["root"]) for clip in waiting)
        with open_clip(part.path(entry.name)) as stored:
            waiting.append({key: stored[key] for key in ("rotations", "root", "domain", "audio")})
        events = {kind: tuple(times.tolist()) for kind, times in part.load(entry.name).events.items()}
        place = {"shard": first + len(shards), "start": start, "sha256": "", "events": events}
        moved = entry.model_copy(update=place)
        is_twice = entry.split == "train" and can_mirror(HUMANOID)
        mirror = moved.model_copy(update={"name": entry.name + MIRROR, "mirrored": True})
        entries += [moved, mirror] if is_twice else [moved]
        if start + entry.frames >= SHARD_FRAMES:
            flush()
    flush()
    return entries, shards


def _link(source: Path, target: Path) -> None:
    make_output_folder(target.parent)
    try:
        os.link(source, target)
    except FileNotFoundError as error:
        raise MotionError(f"shard {source} is missing; prepare the set again") from error
    except OSError:  # another file system, or one without links
        shutil.copyfile(source, target)


def _info(parts: Sequence[Corpus]) -> dict[str, Any]:
    """Kind, terms and split of each part."""
    infos = {part.folder.name: part.manifest.info for part in parts}
    licences = {name: str(info["licence"]) for name, info in infos.items() if info.get("licence")}
    splits = {name: str(info["split_from"]) for name, info in infos.items() if info.get("split_from")}
    return {
        "kind": "merged sets",
        "parts": {part.folder.name: part.manifest.info | {"fingerprint": part.fingerprint} for part in parts},
        "licence": "; ".join(f"{name}: {licence}" for name, licence in licences.items()),
        "split_from": "; ".join(f"{name}: {split}" for name, split in splits.items()),
    }
