"""Bandai-Namco-Research-Motiondataset 1 and 2: short acted motions in many styles, BVH at 30 fps, no sound.

Published as `dataset/Bandai-Namco-Research-Motiondataset-{1,2}/data.zip`, names dataset-{n}_{content}_{style}_{id} with
a JSON label beside each. 22 joints without fingers and an unusual rest pose, which retargeting knows. Good for a
tokenizer; without sound there is nothing for a generator.
"""

import re
from pathlib import Path

from .source import LeftOut, Recording, Survey, Terms, files_below

TERMS = Terms(
    title="Bandai-Namco-Research-Motiondataset",
    origin="https://github.com/BandaiNamcoResearchInc/Bandai-Namco-Research-Motiondataset",
    licence="CC BY-NC 4.0",
    may_ship="with credit and for non-commercial use only; the project ships neither the set nor weights trained on it",
    cite="Kobayashi, Liao, Inoue, Yojima, Takahashi: Motion Capture Dataset for Practical Use of AI-based Motion "
    "Editing and Stylization, 2023",
)
RATES = (30.0,)
_NAME = re.compile(r"(dataset-[12])_(.+)_([a-z-]+)_(\d+)$")


def survey(folder: Path) -> Survey:
    """Every BVH whose name is one of theirs."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    for path in files_below(folder, ".bvh"):
        match = _NAME.match(path.stem)
        if match:
            labels = {"part": match[1], "content": match[2], "style": match[3]}
            recordings.append(Recording(path.stem, path, None, labels=labels, rates=RATES))
        else:
            left_out.append(LeftOut(path.stem, "its name is none of theirs; use `data prepare bvh` for it"))
    there = {recording.labels["part"] for recording in recordings}
    missing = [f"{part} is not there" for part in ("dataset-1", "dataset-2") if part not in there]
    return Survey(TERMS, recordings, missing, left_out, "none published: each tenth by name")
