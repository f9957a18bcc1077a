"""ZeroEGGS (Ubisoft La Forge): 67 monologues of one speaker in 19 styles, BVH and WAV of the same name, 60 fps.

Published as `data/Zeggs_data.zip`, which unpacks to `clean/` (aligned; read here) and `original/` (not aligned; left
out). The validation split is a column of `data/info.csv`; `VALIDATION` repeats it for copies without that file.
Retargeted copies that keep the names are read the same way.
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path

from .source import LeftOut, Recording, Survey, Terms, files_below

TERMS = Terms(
    title="ZeroEGGS (ZEGGS), Ubisoft La Forge",
    origin="https://github.com/ubisoft/ubisoft-laforge-ZeroEGGS",
    licence="CC BY-NC-ND 4.0",
    may_ship="nothing: neither the files, nor this set, nor weights trained on it for commercial use",
    cite="Ghorbani, Ferstl, Holden, Troje, Carbonneau: ZeroEGGS: Zero-shot Example-based Gesture Generation from "
    "Speech. Computer Graphics Forum 42(1), 2023",
)
RATES = (60.0, 30.0)  # published, and the 30 fps copies in use
RECORDINGS = 67
VALIDATION = (5, 10, 15, 20, 25, 29, 33, 35, 38, 41, 44, 47, 50, 53, 56, 58, 61, 64, 65, 66, 67)
_NAME = re.compile(r"(\d{3})_([A-Za-z]+)_(\d+)")


def survey(folder: Path) -> Survey:
    """Find every BVH named like a recording; its sound has the same name and lies beside it."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    official = _official(folder)
    for path in files_below(folder, ".bvh"):
        match = _NAME.match(path.stem)
        if not match:
            left_out.append(LeftOut(path.stem, "its name is not one of ZeroEGGS; prepare it with `data prepare bvh`"))
        elif "original" in path.relative_to(folder).parts:
            left_out.append(LeftOut(f"original/{path.stem}", "not aligned with its sound; clean/ is read"))
        elif "mirror" in path.stem:
            left_out.append(LeftOut(path.stem, "a mirror image; the set has its own"))
        else:
            number, style = int(match[1]), match[2]
            held_out = official.get(match[0], number in VALIDATION)
            recordings.append(
                Recording(
                    name=path.stem,
                    motion=path,
                    sound=path.with_suffix(".wav"),
                    domain="speech",
                    split="test" if held_out else "train",
                    labels={"style": style, "speaker": "1"},
                    rates=RATES,
                )
            )
    numbers = {int(recording.name[:3]) for recording in recordings}
    gone = [number for number in range(1, RECORDINGS + 1) if number not in numbers]
    missing = [f"{len(gone)} of {RECORDINGS} recordings: {_spans(gone)}"] if gone else []
    source = "validation column of info.csv" if official else "published validation list, by number"
    return Survey(TERMS, recordings, missing, left_out, source)


def _official(folder: Path) -> Mapping[str, bool]:
    """Map each recording (as in 001_Neutral_0) to whether it is held out; empty without info.csv."""
    table = next((p for p in (*files_below(folder, ".csv"), folder.parent / "info.csv") if p.name == "info.csv"), None)
    if table is None or not table.is_file():
        return {}
    with table.open(newline="", encoding="utf-8-sig") as file:
        return {
            Path(row["anim_bvh"]).stem: row["validation"].strip().upper() == "TRUE"
            for row in csv.DictReader(file)
            if row.get("anim_bvh") and row.get("validation")
        }


def _spans(numbers: list[int]) -> str:
    """Numbers as ranges, as in "001-004, 007"."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and spans[-1][-1] == number - 1:
            spans[-1] = [spans[-1][0], number]
        else:
            spans.append([number])
    return ", ".join("-".join(f"{n:03d}" for n in span) for span in spans)
