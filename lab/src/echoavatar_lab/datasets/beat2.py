"""BEAT2 (EMAGE): 60 hours of 25 speakers, SMPL-X npz at 30 fps and 16 kHz wav, with an official split by recording.

Published per language as `beat_english_v2.0.0/`: `smplxflame_30/{id}.npz`, `wave16k/{id}.wav` and
`train_test_split.csv` with the columns id and type (train, val, test, additional). An id begins with the speaker's
number and name, as in 2_scott_0_1_1. As in published work, `additional` is left out by default.
"""

import csv
from collections.abc import Mapping
from pathlib import Path

from echoavatar.errors import EchoAvatarError

from .source import LeftOut, Recording, Survey, Terms, files_below

TERMS = Terms(
    title="BEAT2 (BEAT-SMPLX-FLAME)",
    origin="https://huggingface.co/datasets/H-Liu1997/BEAT2",
    licence="the dataset's card says Apache-2.0, its authors' repository CC BY-NC 4.0 for the motion capture; the"
    " SMPL-X body model has a non-commercial licence of its own",
    may_ship="the project treats it as non-commercial and ships neither the set nor weights trained on it",
    cite="Liu et al.: EMAGE: Towards Unified Holistic Co-Speech Gesture Generation via Expressive Masked Audio Gesture "
    "Modeling. CVPR 2024",
)
RATES = (30.0,)
SPLIT = "train_test_split.csv"


def survey(folder: Path, *, has_additional: bool = False) -> Survey:
    """Find the recordings of every language folder below `folder`, by npz file and split table."""
    tables = [path for path in files_below(folder, ".csv") if path.name == SPLIT]
    places = [path.parent for path in tables] or sorted(
        {path.parent.parent for path in files_below(folder, ".npz") if path.parent.name == "smplxflame_30"}
    )
    if not places:
        raise EchoAvatarError(
            f"{folder} holds no {SPLIT} and no smplxflame_30/*.npz; name the folder beat_english_v2.0.0 or one above"
        )
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    missing: list[str] = []
    for place in places:
        official = _table(place / SPLIT)
        if not official:
            missing.append(f"{place.name}/{SPLIT}: no official split")
        there = {path.stem: path for path in files_below(place, ".npz") if path.parent.name == "smplxflame_30"}
        gone = [name for name, kind in official.items() if name not in there and kind != "additional"]
        if gone:
            missing.append(
                f"{len(gone)} recordings of {place.name}/{SPLIT} without npz: {', '.join(gone[:3])}"
                + (", ..." if len(gone) > 3 else "")
            )
        for name, path in sorted(there.items()):
            kind = official.get(name, "")
            if official and not kind:
                left_out.append(LeftOut(name, f"not in {SPLIT}"))
            elif kind == "additional" and not has_additional:
                left_out.append(LeftOut(name, "additional data; pass --additional to use it"))
            else:
                recordings.append(_item(name, path, place, "train" if kind == "additional" else kind))
    return Survey(TERMS, recordings, missing, left_out, f"{SPLIT}, by recording of each speaker")


def _item(name: str, path: Path, place: Path, split: str) -> Recording:
    words = name.split("_")
    labels = {"speaker": words[0], "speaker_name": words[1]} if len(words) > 1 else {}
    labels["language"] = place.name.removeprefix("beat_").partition("_")[0]
    return Recording(name, path, place / "wave16k" / f"{name}.wav", "speech", split, labels, RATES)


def _table(path: Path) -> Mapping[str, str]:
    """Map each recording to train, val, test or additional; empty without a table."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = [(row.get("id") or "", (row.get("type") or "").strip().lower()) for row in csv.DictReader(file)]
    strange = sorted({kind for _, kind in rows} - {"train", "val", "test", "additional"})
    if strange or not rows:
        raise EchoAvatarError(
            f"{path}: expected columns id and type with train, val, test or additional, found"
            f" {', '.join(map(repr, strange)) or 'no rows'}; fetch it again"
        )
    return dict(rows)
