"""The captured library: BVH files as clips of choreography controls, cut, cleaned and smoothed once. Not in the paper.

Each clip starts at the origin and faces +Z, stands on the floor at y = 0, and has our rig's size.
"""

import hashlib
import io
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfiltfilt

from echoavatar.cache import first_writable, user_caches
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_json
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.tables import NPZ_ERRORS, arrays_of
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.motion import align_signs, resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import known_bones
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.whole_file import write_whole
from echoavatar_lab.corpora.controls import Array, Controls, concatenated, facing, moved, spans_of, wander

from .animated import SUFFIXES, read_animated
from .catalogue import Entry, Kind, entry_of
from .controls_from_motion import controls_from_motion
from .footing import stepping
from .units import GestureUnit, cut_out, gesture_unit, rows_of, table_above, unit_rows

VERSION = 5  # of the cached libraries: raise it with every change of what a file becomes
SHORTEST_S = 2.0  # shorter stretches between two cuts are dropped
STILL_M_S = 0.06  # mean speed of the body's joints below which a dance has not begun
LEAD_IN_S = 0.3
SPAN_MARGIN_S = 0.04
FACING_S = 0.5
UPRIGHT_M = 0.12  # a body whose hips are lower by more is not upright
PELVIS_TILT, HEAD_ROLL = 0.10, 0.05  # radians; a take's median beyond this is taken for the rig's
GAZE = (-0.08, 0.10)
MAY_TRAIN = "may train shipped weights"  # column `use` of a manifest
_FINGER_DRIFT = np.array([0.02, 0.03, 0.03, 0.03, 0.03, 0.04, 0.03], np.float32)


@dataclass(frozen=True, eq=False)
class CapturedClip:
    """One stretch of one captured person.

    Attributes:
        name: of the file and, where it was cut, the number of the stretch.
        kind: standing, speech, gesture, dance, action, or unit: one gesture (`units`).
        group: clips of one group look alike, for example `salsa_lead`; of a unit its meaning.
        source: folder and file.
        licence: as the set's manifest states it.
        controls: curves at 30 fps.
    """

    name: str
    kind: Kind
    group: str
    source: str
    licence: str
    controls: Controls

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return len(self.controls) / FRAME_RATE_HZ


@dataclass(frozen=True, eq=False)
class CapturedLibrary:
    """Captured clips."""

    clips: tuple[CapturedClip, ...]

    def of(self, *kinds: Kind) -> tuple[CapturedClip, ...]:
        """Clips of some kinds."""
        return tuple(clip for clip in self.clips if clip.kind in kinds)

    def credits(self) -> dict[str, str]:
        """The licence of each set, for the card of a model that is trained on the library."""
        return {clip.source.split("/")[0]: clip.licence for clip in self.clips}

    def save(self, path: Path) -> None:
        """Write the library as one npz."""
        about = [{name: value for name, value in vars(clip).items() if name != "controls"} for clip in self.clips]
        packed = io.BytesIO()
        np.savez(
            packed,
            curves=concatenated([clip.controls for clip in self.clips]).packed(),
            frames=np.array([len(clip.controls) for clip in self.clips]),
            clips=np.array(json.dumps(about)),
        )
        write_whole(path, packed.getvalue(), error=MotionError)


def open_library(path: Path) -> CapturedLibrary:
    """The library in an npz of `CapturedLibrary.save`, or of a folder of BVH, which is kept in the user's cache.

    Raises MotionError if there is neither, or it is damaged.
    """
    if path.is_dir():
        kept = first_writable(*user_caches()) / f"captured-{_digest(path)}.npz"
        if not kept.exists():
            library = read_folder(path)
            try:
                library.save(kept)
            except MotionError:  # no cache can be written
                return library
        path = kept
    try:
        stored = arrays_of(path, MotionError)
        curves, frames, about = stored["curves"], stored["frames"], read_json(str(stored["clips"]), "clips")
        parts = np.split(curves, np.cumsum(frames)[:-1])
        clips = [CapturedClip(**text, controls=Controls.unpacked(p)) for text, p in zip(about, parts, strict=True)]
        return CapturedLibrary(tuple(clips))
    except FileNotFoundError as error:
        raise MotionError(f"{path} does not exist; make it with `echoavatar data capture FOLDER -o {path}`") from error
    except (*NPZ_ERRORS, EchoAvatarError) as error:
        raise MotionError(f"{path} is no captured library or is damaged ({str(error)[:120]}); make it again") from error


def read_folder(folder: Path, progress: Callable[[str], None] = lambda _: None) -> CapturedLibrary:
    """Read every file below `folder` that the catalogue knows.

    Raises MotionError if the folder holds no such file, or one is damaged.
    """
    licences, clips = _licences(folder), []
    for path in sorted(folder.rglob("*.bvh")):
        entry, source = entry_of(path), f"{path.parent.name}/{path.name}"
        licence, use = licences.get(source, ("not stated", MAY_TRAIN))
        if entry is None or use != MAY_TRAIN:
            continue
        progress(source)
        pieces = list(clean(read_bvh(path), entry, bad_spans(path)))
        for number, controls in enumerate(pieces):
            name = path.stem if len(pieces) == 1 else f"{path.stem}.{number}"
            clips.append(CapturedClip(name, entry.kind, entry.group, source, licence, controls))
    if not clips:
        raise MotionError(f"{folder} holds no captured set; put BVH files into folders named standing, speech or dance")
    return CapturedLibrary((*clips, *_units(folder, licences, progress)))


def _units(
    folder: Path, licences: dict[str, tuple[str, str]], progress: Callable[[str], None]
) -> Iterator[CapturedClip]:
    """Single gestures out of the files that a table of units names."""
    rows = unit_rows(folder)
    for path in sorted(folder.rglob("*")):
        key, entry = f"{path.parent.name}/{path.name}", entry_of(path)
        licence, use = licences.get(key, ("not stated", MAY_TRAIN))
        if key not in rows or use != MAY_TRAIN:
            continue
        progress(key)
        if path.suffix in SUFFIXES:
            whole = controls_from_motion(read_animated(path))
        elif entry and path.suffix == ".bvh":
            whole = next(clean(read_bvh(path), entry))
        else:
            continue
        place = path.relative_to(folder).parts
        source = f"{place[0] if len(place) > 1 else folder.name}/{path.name}"
        for number, row in enumerate(rows[key]):
            if row.end_s * FRAME_RATE_HZ > len(whole) + 2:
                continue  # in what the catalogue cuts off
            yield CapturedClip(f"{path.stem}.{number}", "unit", row.meaning, source, licence, cut_out(whole, row))


def clean(motion: Motion, entry: Entry, bad: Sequence[tuple[float, float]] = ()) -> Iterator[Controls]:
    """The good stretches of a take: cut, smoothed, retargeted with planted feet, moved to the origin."""
    good = _good_frames(motion, entry, bad)
    smooth = _smoothed(motion, entry, good)
    ours = resample(retarget(smooth), FRAME_RATE_HZ)
    shift = _level_shift(controls_from_motion(ours))
    ratio = FRAME_RATE_HZ / motion.fps
    for start, stop in good:
        piece = ours.cut(round(start * ratio), min(round(stop * ratio), ours.frames))
        if entry.kind == "dance":
            piece = _without_stillness(piece)
        is_whole = len(good) == 1 and not bad
        if piece.frames >= SHORTEST_S * FRAME_RATE_HZ or (is_whole and piece.frames > FRAME_RATE_HZ / 2):
            controls = controls_from_motion(piece)
            level = {name: (getattr(controls, name) + by).astype(np.float32) for name, by in shift.items()}
            controls = replace(controls, **level)
            controls = stepping(controls) if entry.kind in ("standing", "speech", "gesture") else controls
            yield _with_finger_drift(_at_origin(controls))


def _digest(folder: Path) -> str:
    """A number that changes with every file of the folder and with this package's way of reading them."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".bvh", ".csv", *SUFFIXES)]
    stats = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return hashlib.sha256(repr((VERSION, stats)).encode()).hexdigest()[:16]


def bad_spans(path: Path) -> list[tuple[float, float]]:
    """Seconds to cut out of a take, from `bad_spans.csv` beside it (file, start_s, end_s)."""
    rows = rows_of(path.with_name("bad_spans.csv"))
    return [(float(r["start_s"]), float(r["end_s"])) for r in rows if r["file"] == path.name]


def _licences(folder: Path) -> dict[str, tuple[str, str]]:
    """Licence and use by the last two parts of a file's path, from `manifest.csv` in or above the folder."""
    rows = rows_of(table_above(folder, "manifest.csv"))
    return {"/".join(Path(r["file"]).parts[-2:]): (r["licence"], r["use"]) for r in rows}


def _good_frames(motion: Motion, entry: Entry, bad: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Stretches of frames between the bad spans."""
    is_good = np.ones(motion.frames, np.bool_)
    for start, end in bad:
        first, last = (start - SPAN_MARGIN_S) * motion.fps, (end + SPAN_MARGIN_S) * motion.fps
        is_good[max(0, int(first)) : int(np.ceil(last)) + 1] = False
    is_good[motion.frames - round(entry.last_s * motion.fps) :] = False
    return [(a, b) for a, b in spans_of(is_good) if b - a > motion.fps / 4]


def _smoothed(motion: Motion, entry: Entry, good: Sequence[tuple[int, int]]) -> Motion:
    """The motion without shaking, each good stretch by itself; a Butterworth filter keeps the timing of strokes."""
    rotations, root = align_signs(motion.rotations).astype(np.float64), motion.root.astype(np.float64)
    bones = known_bones(motion.skeleton)
    if entry.is_head_frozen:
        rotations[:, [bones["neck"], bones["head"]]] = (1.0, 0.0, 0.0, 0.0)
    feet = [joint for bone, joint in bones.items() if bone.endswith(("Foot", "Toes"))]
    others = [joint for joint in range(motion.skeleton.joints) if joint not in feet]
    for start, stop in good:
        span = slice(start, stop)
        rotations[span, others] = _low_pass(rotations[span, others], entry.cutoff_hz, motion.fps)
        rotations[span, feet] = _low_pass(rotations[span, feet], entry.toes_hz, motion.fps)
        root[span] = _low_pass(root[span], entry.cutoff_hz, motion.fps)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    return replace(motion, rotations=rotations.astype(np.float32), root=root.astype(np.float32))


def _low_pass(values: Float[np.ndarray, "t ..."], cutoff_hz: float, fps: float) -> Float[np.ndarray, "t ..."]:
    if cutoff_hz >= 0.5 * fps:
        return values
    filtered: Array = sosfiltfilt(
        butter(2, cutoff_hz, fs=fps, output="sos"), values, axis=0, padlen=min(int(fps), len(values) - 1)
    )
    return filtered


def _without_stillness(motion: Motion) -> Motion:
    """A dance without the still pose before it begins and after it ends."""
    places = motion.pose().positions
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1).mean(1) * motion.fps
    moves = np.flatnonzero(speed > STILL_M_S)
    lead = round(LEAD_IN_S * motion.fps)
    if not len(moves):
        return motion.cut(0, 1)
    return motion.cut(max(0, int(moves[0]) - lead), min(motion.frames, int(moves[-1]) + lead + 1))


def _at_origin(controls: Controls) -> Controls:
    """Hips over the origin, facing +Z, on average over the first half second."""
    first = controls[: max(1, round(FACING_S * FRAME_RATE_HZ))]
    centred = moved(controls, -first.pelvis_position.mean(0)[[0, 2]])
    return moved(centred, np.zeros(2), turn=-facing(first))


def _level_shift(controls: Controls) -> dict[str, Float[np.ndarray, " 3"]]:
    """What makes an upright body's pelvis and gaze level in the median of a take, for rigs whose zero pose is not.

    CMU's hips are pitched by 20 degrees while the back makes up for it, and FreeMoCap's faces look at the floor.
    """
    upright = controls.pelvis_position[:, 1] > np.percentile(controls.pelvis_position[:, 1], 90) - UPRIGHT_M
    pelvis, spine, head = (
        np.median(curve[upright], axis=0) for curve in (controls.pelvis_rotation, controls.spine, controls.head)
    )
    tilt, gaze, side = (
        float(np.angle(np.exp(1j * angle)))  # after a somersault an upright body is a full turn on
        for angle in (pelvis[1], pelvis[1] + spine[1] + head[1], pelvis[2] + spine[2] + head[2])
    )
    turned = np.clip(tilt, -PELVIS_TILT, PELVIS_TILT) - tilt
    raised = np.clip(gaze, *GAZE) - gaze
    upright_head = np.clip(side, -HEAD_ROLL, HEAD_ROLL) - side
    return {
        "pelvis_rotation": np.array([0.0, turned, 0.0]),
        "spine": np.array([0.0, -turned, 0.0]),
        "head": np.array([0.0, raised, upright_head]),
    }


def _with_finger_drift(controls: Controls) -> Controls:
    """Slow drift for hands whose fingers were not captured; the same in every build."""
    if np.ptp(controls.fingers, axis=0).max() > 0:
        return controls
    rng = np.random.default_rng(zlib.crc32(controls.wrist.tobytes()))
    drift = wander(len(controls), 14, period=2.0, rng=rng).reshape(-1, 2, 7) * _FINGER_DRIFT
    return replace(controls, fingers=controls.fingers + drift)


@lru_cache(maxsize=2)
def gesture_units(library: CapturedLibrary) -> tuple[GestureUnit, ...]:
    """The gesture units of a library."""
    return tuple(gesture_unit(clip.controls, clip.group) for clip in library.of("unit"))
