"""A folder of made-up captured people, and the library read from it."""

from pathlib import Path

import numpy as np
import pytest

from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.corpora.capture.library import CapturedLibrary, read_folder
from echoavatar_lab.corpora.gesture.idle import idle
from echoavatar_lab.corpora.solver import solve
from echoavatar_lab.corpora.sound import SoundTrack, Span

SECONDS = 14


@pytest.fixture(scope="session")
def captured_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people who wait and one who talks, with a table of bad spans and a manifest."""
    folder = tmp_path_factory.mktemp("captured")
    for seed, name in enumerate(("standing/anna", "standing/ben", "speech/cleo")):
        phrases = ((1.0, 13.0),) if name.startswith("speech") else ()
        track = SoundTrack(
            np.zeros(SECONDS * 24_000, np.float32), spans=(Span(0.0, float(SECONDS), "silence"),), phrases=phrases
        )
        rotations, root = solve(idle(track, seed))
        (folder / name).parent.mkdir(exist_ok=True)
        write_bvh(folder / f"{name}.bvh", HUMANOID, rotations, root + np.float32([1.0, 0.0, 2.0]), 30.0)
    (folder / "standing" / "bad_spans.csv").write_text("file,start_s,end_s,joints\nben.bvh,6.0,6.5,leftFoot\n")
    (folder / "manifest.csv").write_text(
        "file,licence,use\nstanding/anna.bvh,CC0-1.0,may train shipped weights\n"
        "standing/ben.bvh,MIT,may train shipped weights\nspeech/cleo.bvh,MIT,may train shipped weights\n"
    )
    return folder


@pytest.fixture(scope="session")
def people(captured_folder: Path) -> CapturedLibrary:
    return read_folder(captured_folder)
