"""A small folder in BEAT2's layout, for users without the dataset: rehearsal motion written as SMPL-X.

Names, rates, npz keys and the split table are those of the dataset, so `data prepare beat2` reads it like a real
copy. The motion is procedural and the sound is synthetic, some of it music: no number from it says anything about
BEAT2.
"""

import csv
from pathlib import Path

import numpy as np
import soxr
import torch

from echoavatar.files.exports.smplx import skeleton
from echoavatar.models.audio import write_wav
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.data import Clip, Corpus
from echoavatar_lab.datasets.beat2 import SPLIT

RATE_HZ = 16_000
TEST_EVERY = 8
SPEAKER = "2_scott"


def write_sample(corpus: Corpus, folder: Path) -> Path:
    """Write every clip of a corpus on our rig as a recording of one speaker; return the folder for `data prepare`."""
    place = folder / "beat_english_v2.0.0"
    for name in ("smplxflame_30", "wave16k"):
        (place / name).mkdir(parents=True, exist_ok=True)
    rows = []
    for number, clip in enumerate(corpus.clips(), 1):
        name = f"{SPEAKER}_0_{number}_{number}"
        _write(clip, place, name)
        rows.append((name, "test" if number % TEST_EVERY == 0 else "train"))
    with (place / SPLIT).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("id", "type"), *rows])
    return place


def _write(clip: Clip, place: Path, name: str) -> None:
    rig = skeleton()
    quaternions = torch.zeros(clip.frames, rig.joints, 4)
    quaternions[..., 0] = 1
    for bone, joint in rig.config.vrm.items():
        quaternions[:, joint] = torch.from_numpy(clip.rotations[:, HUMANOID.index(bone)])
    np.savez(
        place / "smplxflame_30" / f"{name}.npz",
        poses=axis_angle_from_quaternion(quaternions).reshape(clip.frames, -1).numpy(),
        trans=clip.root - rig.offsets[0].numpy(),
        betas=np.zeros(300),
        mocap_frame_rate=np.array(FRAME_RATE_HZ),
        gender=np.array("neutral"),
    )
    sound = soxr.resample(clip.audio, SAMPLE_RATE_HZ, RATE_HZ)
    write_wav(place / "wave16k" / f"{name}.wav", sound.astype(np.float32), rate=RATE_HZ)
