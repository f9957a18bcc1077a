"""The files that pages load: a clip is one `motion` message of the live protocol, a sound is FLAC."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile
from jaxtyping import Float

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import whole_file, write_whole
from echoavatar.wire.blobs import Pose, pack_pose, unpack_pose
from echoavatar.wire.codec import decode_server, encode
from echoavatar.wire.messages import Motion as MotionMessage

Progress = Callable[[int, int, str], None]
_SPOILT = ("UpperArm", "LowerArm", "UpperLeg", "LowerLeg")
_SHAKE_RAD = 0.7


class Performance(NamedTuple):
    """Motion and face, as long as the sound they are shown with."""

    motion: Motion
    face: Float[np.ndarray, "t 52"] | None = None


def save_clip(path: Path, shown: Performance) -> None:
    """Write a file that `@echoavatar/client` unpacks, completely or not at all."""
    face = shown.face
    pose = Pose(shown.motion.rotations, shown.motion.root, face)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, encode(pack_pose(pose, at=0, state="acting")))


def load_clip(path: Path) -> Pose:
    """Read a file that `save_clip` wrote.

    Raises:
        ProtocolError: the file is damaged.
    """
    message = decode_server(path.read_bytes())
    assert isinstance(message, MotionMessage)
    return unpack_pose(message, joints=HUMANOID.joints, curves=len(ARKIT_NAMES))


def without_face(path: Path) -> None:
    """Write a clip again with a neutral face."""
    pose = load_clip(path)
    write_whole(path, encode(pack_pose(Pose(pose.rotations, pose.root, None), at=0, state="acting")))


def save_sound(path: Path, audio: Float[np.ndarray, " s"]) -> None:
    """Write 24 kHz mono as FLAC: every browser plays it, and no encoder shifts it against the motion."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, failures=(soundfile.SoundFileError,)) as partial:
        soundfile.write(partial, np.clip(audio, -1, 1), SAMPLE_RATE_HZ, format="FLAC", subtype="PCM_16")


def fit(audio: Float[np.ndarray, " s"], frames: int) -> Float[np.ndarray, " n"]:
    """Cut the sound to a number of frames, or pad it with silence."""
    wanted = frames * SAMPLES_PER_FRAME
    return np.pad(audio[:wanted], (0, max(0, wanted - len(audio)))).astype(np.float32)


def corrupt(shown: Performance, seed: int) -> Performance:
    """The same motion with limbs that shake at random by about 40 degrees, which every attentive rater notices."""
    motion, random = shown.motion, np.random.default_rng([seed, 4])
    rotations = motion.rotations.copy()
    for joint, name in enumerate(HUMANOID.names):
        if name.endswith(_SPOILT):
            turns = quaternion_from_axis_angle(random.normal(0, _SHAKE_RAD, (motion.frames, 3)).astype(np.float32))
            rotations[:, joint] = quaternion_multiply(rotations[:, joint], turns)
    return Performance(Motion(motion.skeleton, rotations, motion.root, motion.fps), shown.face)
