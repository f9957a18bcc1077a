"""Bandai-Namco-Research-Motiondataset 1 and 2: short acted motions in many styles, BVH at 30 fps, no sound.

Published as `dataset/Bandai-Namco-Research-Motiondataset-{1,2}/data.zip` with file names
dataset-{n}_{content}_{style}_{id} and a JSON label beside each file. The rig has 22 joints, no fingers and an unusual
rest pose, which retargeting handles. The set suits a tokenizer; without sound it cannot train a generator.
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
    """Find every BVH whose name follows the dataset's pattern."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    for path in files_below(folder, ".bvh"):
        match = _NAME.match(path.stem)
        if match:
            labels = {"part": match[1], "content": match[2], "style": match[3]}
            recordings.append(Recording(path.stem, path, None, labels=labels, rates=RATES))
        else:
            left_out.append(
                LeftOut(path.stem, "its name is not one of this dataset; prepare it with `data prepare bvh`")
            )
    there = {recording.labels["part"] for recording in recordings}
    missing = [f"{part} is not there" for part in ("dataset-1", "dataset-2") if part not in there]
    return Survey(TERMS, recordings, missing, left_out, "none published: every tenth by name")
