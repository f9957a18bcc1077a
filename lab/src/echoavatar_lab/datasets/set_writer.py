"""Writes parts to a set: shards, manifest and receipts.

A set is valid at every moment: first a shard is written, then `recordings.json` and the manifest that list it, then its
parts are deleted. A run that is interrupted leaves parts, which the next run writes, or files that nothing lists.
"""

import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab.data import Corpus, Manifest, save_manifest
from echoavatar_lab.data.clip import open_clip
from echoavatar_lab.data.corpus import MANIFEST_BYTES, MANIFEST_VALUES, MIRROR, ClipEntry, can_mirror, write_shard
from echoavatar_lab.data.feature_statistics import measure_features

from .prepare_recording import Receipt, part_path
from .source import SetOptions, Terms


class SetWriter:
    """Collects parts and writes them to the set in `folder`, which may hold clips already."""

    def __init__(self, folder: Path, kind: str, terms: Terms, options: SetOptions) -> None:
        """Raises EchoAvatarError if the folder holds something else, or a set with other options."""
        self.folder, self.kind, self.terms, self.options = folder, kind, terms, options
        self.receipts: dict[str, Receipt] = {}
        self._manifest = Manifest(format=2, clips=())
        self._waiting: list[Receipt] = []
        if (folder / "manifest.json").exists():
            self._resume()

    def _resume(self) -> None:
        self._manifest = Corpus(self.folder).manifest
        info = self._manifest.info
        if self._manifest.format != 2 or info.get("layout") != self.kind:
            raise EchoAvatarError(
                f"{self.folder} holds {info.get('layout') or info.get('kind') or 'another corpus'}, not a set made from"
                f" {self.kind}; choose another -o"
            )
        ours = self.options.binding()
        theirs = info.get("options", {})
        changed = [key for key, value in ours.items() if theirs.get(key) != value]
        if changed:
            before, now = (", ".join(f"{key} {one.get(key)}" for key in changed) for one in (theirs, ours))
            raise EchoAvatarError(
                f"{self.folder} was made with {before}, this call says {now}; use the same options or choose another -o"
            )
        try:
            stored = read_object_file(self.folder / "recordings.json", most=MANIFEST_BYTES, most_values=MANIFEST_VALUES)
            self.receipts = {name: Receipt.model_validate(receipt) for name, receipt in stored.items()}
        except (OSError, EchoAvatarError, ValueError) as error:
            raise EchoAvatarError(
                f"{self.folder / 'recordings.json'} is missing or damaged; delete {self.folder} and prepare it again"
            ) from error
        names = {entry.name for entry in self._manifest.clips}
        self.receipts = {name: receipt for name, receipt in self.receipts.items() if name in names}

    def holds(self, name: str, stamp: str) -> bool:
        """Whether the set holds this recording, made of the same files."""
        return name in self.receipts and self.receipts[name].stamp == stamp

    def assign_splits(self, splits: Mapping[str, str]) -> None:
        """Give the set's clips the splits of this run; only training clips have mirror images."""
        clips: list[ClipEntry] = []
        for entry in self._manifest.clips:
            if not entry.mirrored:
                split = splits.get(entry.name, entry.split)
                clips += self._with_mirror(entry.model_copy(update={"split": split}))
                receipt = self.receipts[entry.name]
                self.receipts[entry.name] = receipt.model_copy(update={"split": split})
        self._manifest = self._manifest.model_copy(update={"clips": tuple(clips)})

    def add(self, receipt: Receipt) -> None:
        """Add a finished part; write a shard when it is full."""
        if self._waiting and self._waiting[0].skeleton != receipt.skeleton:
            self.flush()
        self._waiting.append(receipt)
        if sum(one.frames for one in self._waiting) >= self.options.shard_minutes * 60 * FRAME_RATE_HZ:
            self.flush()

    def flush(self) -> None:
        """Write all waiting parts: clips with sound to one shard, clips without to another."""
        skeleton = self._skeleton(self._waiting[0].skeleton) if self._waiting else 0
        for has_sound in (True, False):
            chosen = [receipt for receipt in self._waiting if receipt.has_sound == has_sound]
            if chosen:
                self._pack(chosen, skeleton, has_sound=has_sound)
        packed, self._waiting = self._waiting, []
        self._write()
        for receipt in packed:
            part_path(self.folder, receipt.name).unlink(missing_ok=True)
            part_path(self.folder, receipt.name).with_suffix(".json").unlink(missing_ok=True)

    def finish(self, split_from: str) -> Corpus:
        """Write the remaining parts and the statistics of the whole set."""
        self.flush()
        corpus = Corpus(self.folder)
        info = self._info() | {"split_from": split_from, "statistics": statistics(corpus, self.receipts)}
        parts = self.folder / "parts"
        if parts.is_dir() and not any(parts.iterdir()):
            parts.rmdir()
        return save_manifest(self.folder, self._manifest.model_copy(update={"info": info}))

    def _pack(self, receipts: Sequence[Receipt], skeleton: int, *, has_sound: bool) -> None:
        keys = ["rotations", "root", "domain", *(["audio"] if has_sound else [])]
        pieces: dict[str, list[Any]] = {key: [] for key in keys}
        for receipt in receipts:
            with open_clip(part_path(self.folder, receipt.name)) as stored:
                for key in keys:
                    pieces[key].append(stored[key])
        number = len(self._manifest.shards)
        arrays = {key: np.concatenate(value) for key, value in pieces.items()}
        shard = write_shard(self.folder, f"{number:05d}", arrays, skeleton=skeleton)
        self._manifest = self._manifest.model_copy(update={"shards": (*self._manifest.shards, shard)})
        self._list(receipts, number)

    def _list(self, receipts: Sequence[Receipt], number: int) -> None:
        new: list[ClipEntry] = []
        start = 0
        for receipt in receipts:
            entry = ClipEntry(
                name=receipt.name,
                split=receipt.split,
                frames=receipt.frames,
                domains=receipt.domains,
                shard=number,
                start=start,
                has_sound=receipt.has_sound,
                events=receipt.events,
                labels=receipt.labels,
            )
            new += self._with_mirror(entry)
            start += receipt.frames
            self.receipts[receipt.name] = receipt.model_copy(update={"skeleton": None, "events": {}})
        names = {receipt.name for receipt in receipts}
        kept = [entry for entry in self._manifest.clips if entry.name.removesuffix(MIRROR) not in names]
        clips = tuple(sorted([*kept, *new], key=lambda entry: entry.name))
        self._manifest = self._manifest.model_copy(update={"clips": clips})

    def _with_mirror(self, entry: ClipEntry) -> list[ClipEntry]:
        """A clip, and its mirror image if it is for training and its rig is symmetric."""
        rigs, shard = self._manifest.skeletons, self._manifest.shards[entry.shard or 0]
        rig = Skeleton(rigs[shard.skeleton]) if rigs else HUMANOID
        if not self.options.mirror or entry.split != "train" or not can_mirror(rig):
            return [entry]
        return [entry, entry.model_copy(update={"name": entry.name + MIRROR, "mirrored": True})]

    def _skeleton(self, rig: SkeletonConfig | None) -> int:
        """Index of a rig in the manifest, where a new rig is added; the humanoid needs no entry."""
        if rig is None:
            return 0
        rigs = list(self._manifest.skeletons)
        if rig not in rigs:
            rigs.append(rig)
            self._manifest = self._manifest.model_copy(update={"skeletons": tuple(rigs)})
        return rigs.index(rig)

    def _write(self) -> None:
        make_output_folder(self.folder)
        stored = {
            name: receipt.model_dump(mode="json", exclude_defaults=True)
            for name, receipt in sorted(self.receipts.items())
        }
        write_json(self.folder / "recordings.json", stored)
        info = self._info() | {"statistics": self._manifest.info.get("statistics", {})}
        self._manifest = self._manifest.model_copy(update={"info": info})
        save_manifest(self.folder, self._manifest)

    def _info(self) -> dict[str, Any]:
        return {
            "kind": "prepared dataset",
            "layout": self.kind,
            "source": self.terms.model_dump(mode="json"),
            "licence": self.terms.licence,
            "options": self.options.model_dump(mode="json"),
            "seed": self.options.seed,
            "echoavatar": importlib.metadata.version("echoavatar"),
            "split_from": self._manifest.info.get("split_from", ""),
        }


def statistics(corpus: Corpus, receipts: dict[str, Receipt]) -> dict[str, Any]:
    """Minutes by split and kind of sound, means of the motion statistics, mean and deviation of the features."""
    entries = corpus.entries(has_mirrored=False)
    splits = sorted({entry.split for entry in entries})
    frames = sum(entry.frames for entry in entries)
    keys = next(iter(receipts.values())).motion if receipts else {}
    return {
        "clips": {split: len(corpus.names(split, has_mirrored=False)) for split in splits},
        "minutes": {split: round(corpus.frames(split) / FRAME_RATE_HZ / 60, 3) for split in splits},
        "heard_minutes": {
            kind: round(sum(e.domains[kind] for e in entries if e.has_sound) / FRAME_RATE_HZ / 60, 3)
            for kind in ("silence", "speech", "music")
        },
        "mirror_images": len(corpus.names()) - len(entries),
        "motion": {
            key: round(sum(receipts[e.name].motion[key] * e.frames for e in entries) / frames, 5) for key in keys
        },
        "features": _features(corpus),
    }


def _features(corpus: Corpus) -> dict[str, list[float]]:
    """Mean and deviation of the motion features over the training clips, if all have the same rig."""
    names = corpus.names("train", has_mirrored=False)
    try:
        skeleton = corpus.skeleton
    except MotionError:
        return {}
    if not names:
        return {}
    clips = (corpus.motion(name) for name in names)
    mean, std, _ = measure_features(
        torch.from_numpy(to_features(skeleton, matrix_from_quaternion(one.rotations), one.root)) for one in clips
    )
    return {name: [round(v, 6) for v in values.tolist()] for name, values in (("mean", mean), ("std", std))}


def write_json(path: Path, content: object) -> None:
    """Write JSON, completely or not at all."""
    write_whole(path, json.dumps(content, indent=1, sort_keys=True) + "\n")
