"""Face clips: sound and the curves that go with it, 24 kHz and 30 frames per second, one `.npz` without pickles.

The names of the curves are stored with them, so a file from elsewhere may hold fewer, or another order.

Takes of Live Link Face (Epic's iPhone app; how the paper's data was captured) become clips: a CSV per take, its sound
beside it. Columns go by name, in any order. Rows are placed by their timecode (`hh:mm:ss:ff.thousandths`, ff counting
1/60 or 1/30 s), so dropped frames do no harm, and are resampled to 30 frames per second. Paper: "60fps using
LiveLinkFace, downsampled to 30fps".
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.limits import read_text
from echoavatar.motion.arkit import ARKIT_NAMES, reorder
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder, whole_file

_PCM = 32767.0
TAKE_BYTES = 1 << 28  # of a take of Live Link Face: an hour has some 100 MB
SPLITS = ("train", "test")


@dataclass(frozen=True)
class FaceClip:
    """Sound and curves of equal length."""

    name: str  # file-safe name
    audio: Float[np.ndarray, " s"]  # (800 t,) float32 mono at 24 kHz
    curves: Float[np.ndarray, "t c"]  # (t, 52) float32 in canonical order
    split: str = "train"  # "train" or "test"

    def __post_init__(self) -> None:
        """Raises MotionError for shapes that do not fit and values that are not finite."""
        frames = len(self.curves)
        if self.curves.shape != (frames, len(ARKIT_NAMES)) or not frames:
            raise MotionError(f"face clip {self.name}: curves have shape {self.curves.shape}, wanted (frames, 52)")
        if self.audio.shape != (frames * SAMPLES_PER_FRAME,):
            raise MotionError(
                f"face clip {self.name}: {self.audio.shape} samples for {frames} frames; wanted "
                f"{frames * SAMPLES_PER_FRAME} (800 per frame)"
            )
        if not (np.isfinite(self.curves).all() and np.isfinite(self.audio).all()):
            raise MotionError(f"face clip {self.name}: some values are not numbers; repair or drop those frames")
        if self.split not in SPLITS:
            raise MotionError(f"face clip {self.name}: split is {self.split!r}, use one of {', '.join(SPLITS)}")

    def save(self, path: Path) -> None:
        """Write the clip, whole or not at all; sound as 16-bit PCM, curves as float16."""
        make_output_folder(path.parent, error=MotionError)
        with whole_file(path, error=MotionError) as partial, partial.open("wb") as file:
            np.savez_compressed(
                file,
                name=np.array(self.name),
                audio=np.round(np.clip(self.audio, -1, 1) * _PCM).astype(np.int16),
                curves=self.curves.astype(np.float16),
                channels=np.array(ARKIT_NAMES),
                split=np.array(self.split),
            )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a clip. Raises MotionError if the file is missing, damaged or not a face clip."""
        try:
            with NpzArrays(path, MotionError) as file:
                audio = file["audio"].astype(np.float32) / _PCM
                curves = reorder(file["curves"].astype(np.float32), [str(name) for name in file["channels"]])
                return cls(str(file["name"]), audio.astype(np.float32), curves, str(file["split"]))
        except NPZ_ERRORS as error:
            raise MotionError(f"{path} is not a readable face clip ({error}); make it again") from error


def load_clips(folder: Path) -> list[FaceClip]:
    """All clips of a folder, by name. Raises MotionError if there are none, or one is damaged."""
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise MotionError(f"{folder} holds no face clips (*.npz); make some with 'echoavatar data face'")
    return [FaceClip.load(path) for path in paths]


_SLOWEST_HZ, _FASTEST_HZ = 20.0, 130.0
_LONGEST_GAP_S = 0.5
_MOST_APART_S = 0.5
_TIMECODE = re.compile(r"(\d+):(\d+):(\d+):(\d+(?:\.\d+)?)")


def read_live_link(path: Path, *, timecode_hz: int | None = None) -> Float[np.ndarray, "t 52"]:
    """The curves of a take in canonical order, 30 frames per second, clipped to 0..1.

    `timecode_hz` (30 or 60) is the rate that frame numbers count at; by default 60 if any is over 29, else 30. Raises
    MotionError if the file cannot be read; columns are missing; a value is no number; times run backwards, leave a gap
    or fit no camera.
    """
    header, rows = _rows(path)
    names = [name[:1].lower() + name[1:] for name in header]
    missing = [name for name in ("timecode", *ARKIT_NAMES) if name not in names]
    if missing:
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise MotionError(f"{path}: no column for {shown}; export the take from Live Link Face as CSV")
    kept = [(line, row) for line, row in rows if len(row) == len(names)]  # shorter rows: no face was seen
    if len(kept) < 2:
        raise MotionError(f"{path} has {len(kept)} rows with a face; record a longer take")
    times = _seconds(path, [(line, row[names.index("timecode")]) for line, row in kept], timecode_hz)
    columns = [names.index(name) for name in ARKIT_NAMES]
    values = np.array([_numbers(path, line, [row[i] for i in columns]) for line, row in kept])
    _check_rate(path, times, [line for line, _ in kept])
    frames = int((times[-1] - times[0]) * FRAME_RATE_HZ + 1e-6) + 1
    grid = np.arange(frames) / FRAME_RATE_HZ
    curves = np.stack([np.interp(grid, times - times[0], column) for column in values.T], axis=1)
    return np.asarray(np.clip(curves, 0, 1), np.float32)


def pair_with_audio(
    name: str,
    curves: Float[np.ndarray, "t 52"],
    audio: Float[np.ndarray, " s"],
    *,
    offset_s: float = 0.0,
    split: str = "train",
) -> FaceClip:
    """A clip from a take's curves and its sound (24 kHz mono); `offset_s` is when the take begins in the sound.

    Raises MotionError: their lengths differ by more than half a second, or nothing is left.
    """
    start = round(offset_s * SAMPLE_RATE_HZ)
    heard = audio[start:] if start >= 0 else np.concatenate([np.zeros(-start, np.float32), audio])
    seconds, shown = len(heard) / SAMPLE_RATE_HZ, len(curves) / FRAME_RATE_HZ
    if abs(seconds - shown) > _MOST_APART_S:
        raise MotionError(
            f"{name}: {seconds:.2f} s of sound but {shown:.2f} s of face; give the sound of the same take, "
            "or say where the take begins in it (--offset)"
        )
    frames = min(len(curves), len(heard) // SAMPLES_PER_FRAME)
    if frames < 1:
        raise MotionError(f"{name}: no whole frame of sound and face together")
    sound = heard[: frames * SAMPLES_PER_FRAME].astype(np.float32)
    return FaceClip(name, sound, curves[:frames], split)


def _rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Header and (line, values) of a file; empty lines are dropped."""
    try:
        text = io.StringIO(read_text(path, "give a take of Live Link Face", largest=TAKE_BYTES), newline="")
        lines = [(i, [value.strip() for value in row]) for i, row in enumerate(csv.reader(text), 1) if row]
    except (EchoAvatarError, csv.Error) as error:
        raise MotionError(f"{path} cannot be read as CSV ({error}); give a take of Live Link Face") from error
    if not lines:
        raise MotionError(f"{path} is empty; give a take of Live Link Face")
    return lines[0][1], lines[1:]


def _numbers(path: Path, line: int, values: list[str]) -> list[float]:
    try:
        numbers = [float(value) for value in values]
    except ValueError as error:
        raise MotionError(f"{path}, line {line}: {error}; repair or delete the line") from error
    if not np.isfinite(numbers).all():
        raise MotionError(f"{path}, line {line}: a value is not finite; repair or delete the line")
    return numbers


def _seconds(path: Path, stamps: list[tuple[int, str]], timecode_hz: int | None) -> Float[np.ndarray, " t"]:
    parts = []
    for line, stamp in stamps:
        match = _TIMECODE.fullmatch(stamp)
        if match is None:
            raise MotionError(f"{path}, line {line}: {stamp!r} is not a timecode like 13:04:31:28.652")
        parts.append([float(group) for group in match.groups()])
    hours, minutes, seconds, counts = np.array(parts).T
    base = timecode_hz or (60 if counts.max() >= 30 else 30)
    times: Float[np.ndarray, " t"] = 3600 * hours + 60 * minutes + seconds + counts / base
    return np.asarray(times + 86_400 * (times < times[0] - 43_200))  # a take over midnight


def _check_rate(path: Path, times: Float[np.ndarray, " t"], lines: list[int]) -> None:
    """Refuse times that run backwards, leave a gap, or fit no camera."""
    steps = np.diff(times)
    if steps.min() <= 0:
        at = lines[int(steps.argmin()) + 1]
        raise MotionError(f"{path}, line {at}: the timecode does not advance; sort the rows, or delete the line")
    rate = float(1 / np.median(steps))
    if not _SLOWEST_HZ <= rate <= _FASTEST_HZ:
        raise MotionError(
            f"{path}: {rate:.1f} frames per second; wanted {_SLOWEST_HZ:.0f} to {_FASTEST_HZ:.0f}: record at 30 or 60, "
            "or say what the timecode's frames count"
        )
    if steps.max() > _LONGEST_GAP_S:
        at = lines[int(steps.argmax()) + 1]
        raise MotionError(f"{path}, line {at}: {steps.max():.2f} s without a face before it; cut the take there")
