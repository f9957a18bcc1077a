"""What a run would do, from file headers alone: lengths of recordings, missing files, errors."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import av

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.audio.io import open_sound
from echoavatar.motion.formats.tables import NpzArrays
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

from .options import Options
from .prepare_dataset import Failure
from .source import Recording, with_splits

BYTES_PER_FRAME = 52 * 16 + 12 + 1  # motion on our rig
_LINES = 20_000  # longest hierarchy of a BVH


class Forecast(NamedTuple):
    """What a run would make."""

    seconds: dict[str, float]  # by split
    clips: dict[str, int]
    failures: tuple[Failure, ...]
    bytes: int


def forecast(recordings: Sequence[Recording], options: Options) -> Forecast:
    """Read the headers of all recordings; write nothing."""
    seconds: dict[str, float] = {}
    clips: dict[str, int] = {}
    failures: list[Failure] = []
    size = 0
    for recording in with_splits(recordings, options.test_every):
        try:
            lasts, has_sound = _seconds(recording, options)
        except EchoAvatarError as error:
            failures.append(Failure(recording.name, " ".join(str(error).split())))
            continue
        seconds[recording.split] = seconds.get(recording.split, 0.0) + lasts
        clips[recording.split] = clips.get(recording.split, 0) + 1
        size += int(lasts * FRAME_RATE_HZ) * (BYTES_PER_FRAME + (2 * SAMPLES_PER_FRAME if has_sound else 0))
    return Forecast(seconds, clips, tuple(failures), size)


def _seconds(recording: Recording, options: Options) -> tuple[float, bool]:
    frames, fps = motion_header(recording.motion)
    moves = frames / fps
    if recording.sound is None or options.sound == "none" or (options.sound == "any" and not recording.sound.is_file()):
        return moves, False
    sounds = sound_seconds(recording.sound)
    if abs(moves - sounds) > options.length_tolerance * max(moves, sounds):
        raise MotionError(
            f"{recording.motion.name} lasts {moves:.1f} s at {fps:g} frames per second, its sound {sounds:.1f} s"
        )
    return min(moves, sounds), True


def motion_header(path: Path) -> tuple[int, float]:
    """Frames and frame rate of a BVH or SMPL-X npz.

    Raises:
        MotionError: the file is missing or has no such header.
    """
    try:
        if path.suffix.lower() == ".npz":
            with NpzArrays(path, MotionError) as stored:
                rate = stored.get("mocap_frame_rate", 30.0)
                return len(stored["trans"]), float(rate)
        found: dict[str, float] = {}
        with path.open(encoding="utf-8-sig") as file:
            for line, _ in zip(file, range(_LINES), strict=False):
                label, _, value = line.strip().partition(":")
                if label in ("Frames", "Frame Time"):
                    found[label] = float(value)
                if len(found) == 2:
                    return int(found["Frames"]), 1 / found["Frame Time"]
    except (OSError, ValueError, KeyError, ZeroDivisionError, UnicodeDecodeError) as error:
        raise MotionError(f"{path} cannot be read ({error}); fetch it again") from error
    raise MotionError(f"{path} ends before its motion; it is incomplete, fetch it again")


def sound_seconds(path: Path) -> float:
    """Length of a sound file in seconds, from its header.

    Raises:
        MotionError: the file is missing or is not sound.
    """
    if not path.is_file():
        raise MotionError(f"{path} is missing; add it, or pass --sound any to take the motion alone")
    try:
        with open_sound(path) as container:
            lasts = container.duration
    except av.FFmpegError as error:
        raise MotionError(f"{path} is not a sound file ({error.strerror}); fetch it again") from error
    if not lasts:
        raise MotionError(f"{path} does not say how long it is; convert it to WAV")
    return float(lasts) / av.time_base
