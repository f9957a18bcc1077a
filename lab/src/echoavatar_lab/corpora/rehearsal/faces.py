"""Procedural face clips: rehearsal sound with lip curves made from its phones (`speech.lips`).

The paper captures one speaker with a phone; nothing captured may ship with us, so the default face learns from
synthetic speech of several voices. A clip depends on the seed and its number alone.
"""

from pathlib import Path

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.models.face.clip import FaceClip
from echoavatar_lab.progress import Progress, watched

from ..speech.lips import lip_curves
from .track import compose_track

CLIP_SECONDS = 64.0
TEST_EVERY = 8
MIXED_EVERY = 3  # one clip in three has music and long silence as well, in which the mouth is still


def rehearse_clip(seed: int, index: int, seconds: float = CLIP_SECONDS) -> FaceClip:
    """Make one clip; every eighth is of split "test", with sentences of its own."""
    split = "test" if index % TEST_EVERY == TEST_EVERY - 1 else "train"
    own = int(np.random.SeedSequence([seed, index, 0xFACE]).generate_state(1)[0])
    mix = "mixed" if index % MIXED_EVERY == 1 else "speech"
    track = compose_track(own, seconds, mix=mix, split=split)
    curves = lip_curves(track, ARKIT_NAMES)
    audio = np.asarray(track.audio[: len(curves) * SAMPLES_PER_FRAME], np.float32)
    return FaceClip(_name(seed, index), audio, curves, split)


def _name(seed: int, index: int) -> str:
    return f"face-{seed}-{index:04d}"


def rehearse_faces(folder: Path, *, hours: float, seed: int, progress: Progress | None = None) -> int:
    """Make or complete a folder of clips and return their number.

    Raises EchoAvatarError: hours is not positive, or the folder cannot be written.
    """
    if not hours > 0:
        raise EchoAvatarError(f"--hours must be positive, got {hours}")
    count = max(TEST_EVERY, round(hours * 3600 / CLIP_SECONDS))
    with hold_folder(folder):
        for index in watched(range(count), progress):
            path = folder / f"{_name(seed, index)}.npz"
            if not path.exists():
                rehearse_clip(seed, index).save(path)
        return count
