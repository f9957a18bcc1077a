"""Recorded clips woven into the made-up motion, warped in time so that strokes fall on stress and hits on beats.

Clips lend torso, head, arms and (where they move) fingers to some phrases and to some stretches of sixteen beats. The
legs stay the made-up ones: their steps are on the beat and their planted feet do not slide, which recorded legs over
another tempo would. Which clip serves for what is read from its file name; what is neither talk nor dance is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from ..errors import MotionError
from ..fingers import load_shipped, refine_fingers
from ..kinematics import HUMANOID, Motion, read_bvh
from ..kinematics.resample import align_signs, resample
from ..kinematics.retarget import retarget
from ..kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_multiply,
    slerp,
)
from ..timing import FRAME_RATE_HZ
from .sound import SoundTrack

Array = np.ndarray
SPEECH_NAMES = ("talk", "conversation")
DANCE_NAMES = ("dance",)
STROKE_DELAY_S = 0.14  # strokes end this long after the stressed vowel, as in made-up gestures
FADE_S = 0.5
SMOOTHING_FRAMES = 1.35
MAX_SPEED_DEG_S = 850.0  # no clip is hurried beyond this
SPEECH_SHARE, DANCE_SHARE = 0.35, 0.3  # of phrases and of eight-beat stretches
RATES = (0.7, 1.45)  # how far a clip may be slowed or hurried


@dataclass(frozen=True)
class Piece:
    """A recorded clip on our rig, with the moments that should meet the sound."""

    name: str
    kind: Literal["speech", "dance"]
    motion: Motion
    accents: Float[np.ndarray, " n"]  # seconds: ends of strokes, or the hits of a dance
    fastest: float  # highest joint speed, degrees per second
    has_fingers: bool


@dataclass(frozen=True)
class Library:
    """Pieces by what they are for."""

    speech: tuple[Piece, ...]
    dance: tuple[Piece, ...]


def load_library(folder: Path, *, is_refined: bool = False) -> Library:
    """Read, retarget and resample every usable BVH below `folder`; `is_refined` gives frozen hands new fingers.

    Raises:
        MotionError: the folder holds nothing usable, or a usable file is broken.
    """
    pieces = [_piece(path, is_refined) for path in sorted(folder.rglob("*.bvh")) if _kind(path.stem)]
    if not pieces:
        wanted = ", ".join(SPEECH_NAMES + DANCE_NAMES)
        raise MotionError(
            f"{folder} holds no BVH whose name contains one of: {wanted}; give another --library"
        )
    by_kind = {kind: tuple(piece for piece in pieces if piece.kind == kind) for kind in ("speech", "dance")}
    return Library(by_kind["speech"], by_kind["dance"])


def weave(library: Library, track: SoundTrack, motion: Motion, seed: int) -> Motion:
    """The same motion with recorded stretches blended in; deterministic for a seed."""
    rng = np.random.default_rng([seed, 0x11B])
    rotations = motion.rotations.copy()
    if library.speech:
        for start, end in track.phrases:
            if end - start > 1.2 and rng.random() < SPEECH_SHARE:
                _weave_phrase(
                    library.speech[rng.integers(len(library.speech))], track, start, end, rotations, rng
                )
    if library.dance:
        for start, end in _stretches(track):
            if rng.random() < DANCE_SHARE:
                piece = library.dance[rng.integers(len(library.dance))]
                _weave_dance(piece, np.asarray(track.beats), start, end, rotations)
    return replace(motion, rotations=rotations)


def _kind(name: str) -> Literal["speech", "dance"] | None:
    if any(word in name for word in DANCE_NAMES):
        return "dance"
    return "speech" if any(word in name for word in SPEECH_NAMES) else None


def _piece(path: Path, is_refined: bool) -> Piece:
    kind = _kind(path.stem)
    assert kind is not None
    motion = resample(retarget(read_bvh(path)), FRAME_RATE_HZ)
    if is_refined:
        motion = refine_fingers(load_shipped(), motion, hands="frozen")
    motion = _calmed(motion, is_loop=kind == "dance")
    fingers = motion.rotations[:, list(HUMANOID.config.parts["hands"])]
    upper = torch.from_numpy(motion.rotations[:, list(HUMANOID.config.parts["upper"])])
    turned = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(upper[:-1]), upper[1:]))
    fastest = float(torch.rad2deg(turned.norm(dim=-1)).max()) * FRAME_RATE_HZ
    is_alive = bool(np.abs(np.diff(fingers, axis=0)).max(initial=0) > 1e-3)
    return Piece(path.stem, kind, motion, _accents(motion, kind), fastest, is_alive)


def _calmed(motion: Motion, *, is_loop: bool) -> Motion:
    """Capture noise smoothed away (45 ms), which would read as trembling; loops are smoothed across their seam."""
    turns = align_signs(motion.rotations).astype(np.float64)
    if is_loop:
        turns = _seamless(turns)
    turns = gaussian_filter1d(turns, SMOOTHING_FRAMES, axis=0, mode="wrap" if is_loop else "nearest")
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    return replace(motion, rotations=turns.astype(np.float32))


def _seamless(turns: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """Spread what the last frame lacks to lead into the first over the last quarter of the loop."""
    gap = turns[0] - (2 * turns[-1] - turns[-2])
    closes = (turns[0] * turns[-1]).sum(-1, keepdims=True) > 0  # a joint that made a full turn does not
    rise = np.clip((np.arange(len(turns)) / len(turns) - 0.5) * 2, 0, 1) ** 2
    return turns + rise[:, None, None] * np.where(closes, gap, 0)


def _accents(motion: Motion, kind: str) -> Float[np.ndarray, " n"]:
    """Speech: ends of strokes, where a wrist comes to rest after a fast movement. Dance: hardest braking."""
    positions = gaussian_filter1d(motion.pose().positions.numpy(), 1.0, axis=0, mode="nearest")
    joints = HUMANOID.indices(("leftHand", "rightHand")) if kind == "speech" else list(range(HUMANOID.joints))
    speed = np.linalg.norm(np.diff(positions[:, joints] - positions[:, :1], axis=0), axis=-1).mean(1)
    braking = -np.diff(speed)
    at = find_peaks(braking, height=np.percentile(braking, 75), distance=6)[0]
    return np.asarray((at + (3.0 if kind == "speech" else 1.5)) / FRAME_RATE_HZ)


def _weave_phrase(
    piece: Piece, track: SoundTrack, start: float, end: float, rotations: Array, rng: np.random.Generator
) -> None:
    """Blend a stretch of the piece over the upper body during a phrase."""
    stress = [
        s.vowel + STROKE_DELAY_S for s in track.syllables if s.prominence >= 0.45 and start <= s.vowel <= end
    ]
    length = end - start + 2 * FADE_S
    latest = piece.motion.seconds - length * RATES[1]
    if latest <= 0:
        return
    source_start = float(rng.uniform(0, latest))
    warp = _warp(piece.accents, np.array(stress), start - FADE_S, end + FADE_S, source_start)
    frames = _frames(start - FADE_S, end + FADE_S, len(rotations))
    source = np.clip(warp(frames / FRAME_RATE_HZ), 0, piece.motion.seconds - 0.05)
    _mix(rotations, frames, piece, source, _fade(frames, start - FADE_S, end + FADE_S))


def _weave_dance(
    piece: Piece, beats: Float[np.ndarray, " n"], start: float, end: float, rotations: Array
) -> None:
    """Blend the looped piece over the upper body, a whole number of beats to the loop; nothing if no tempo fits."""
    inside = beats[(beats >= start - 1e-6) & (beats <= end + 1e-6)]
    loop, beat = piece.motion.seconds, float(np.median(np.diff(inside)))
    fastest_rate = min(RATES[1], MAX_SPEED_DEG_S / piece.fastest)
    counts = [n for n in (1, 2, 3, 4, 6, 8, 12, 16) if RATES[0] < loop / (n * beat) < fastest_rate]
    if not counts:
        return
    step = loop / min(counts, key=lambda n: abs(np.log(loop / (n * beat))))
    times = np.concatenate([[inside[0] - beat], inside, [inside[-1] + beat]])
    places = _best_phase(piece.accents, step) + step * (np.arange(len(times)) - 1)
    frames = _frames(start, end, len(rotations))
    source = PchipInterpolator(times, places, extrapolate=True)(frames / FRAME_RATE_HZ) % loop
    _mix(rotations, frames, piece, source, _fade(frames, start, end))


def _warp(
    accents: Float[np.ndarray, " n"],
    targets: Float[np.ndarray, " m"],
    start: float,
    end: float,
    source_start: float,
) -> PchipInterpolator:
    """Map of track time to clip time that carries accents onto targets without hurrying or dragging too much."""
    times, places = [start], [source_start]
    for target in targets:
        gap = target - times[-1]
        if gap < 0.25 or target > end - 0.2:
            continue
        fitting = [a for a in accents if RATES[0] < (a - places[-1]) / gap < RATES[1]]
        if fitting:
            times.append(float(target))
            places.append(min(fitting, key=lambda a: abs(a - places[-2 if len(places) > 1 else -1] - gap)))
    times.append(end)
    places.append(places[-1] + end - times[-2])
    return PchipInterpolator(times, places, extrapolate=True)


def _mix(
    out: Array,
    frames: NDArray[np.int64],
    piece: Piece,
    source: Float[np.ndarray, " t"],
    weight: Float[np.ndarray, " t"],
) -> None:
    """Slerp torso, head, arms and living fingers towards the piece at its own times `source`."""
    joints = list(HUMANOID.config.parts["upper"])
    if piece.has_fingers:
        joints += list(HUMANOID.config.parts["hands"])
    grid = np.ix_(frames, np.array(joints))
    share = torch.from_numpy(np.repeat(weight[:, None], len(joints), 1).astype(np.float32))
    turned = torch.from_numpy(_sampled(piece.motion, source)[:, joints])
    out[grid] = slerp(torch.from_numpy(out[grid]), turned, share).numpy()


def _sampled(motion: Motion, times: Float[np.ndarray, " t"]) -> Array:
    """Rotations of a motion at any times within it, by slerp; the last frame leads back to the first."""
    at = times * motion.fps
    low = np.floor(at).astype(int) % motion.frames
    high = (low + 1) % motion.frames
    share = torch.from_numpy((at - np.floor(at)).astype(np.float32))[:, None].expand(
        -1, motion.skeleton.joints
    )
    a, b = torch.from_numpy(motion.rotations[low]), torch.from_numpy(motion.rotations[high])
    return slerp(a, b, share).numpy()


def _best_phase(accents: Float[np.ndarray, " n"], step: float) -> float:
    """Where in the clip a beat should lie: the circular mean of its accents modulo the beat."""
    if not len(accents):
        return 0.0
    angle = np.angle(np.exp(2j * np.pi * accents / step).mean())
    return float(angle / (2 * np.pi) * step % step)


def _stretches(track: SoundTrack) -> Sequence[tuple[float, float]]:
    """Music in pieces of sixteen beats, a little away from where it begins and ends."""
    found = []
    for span in track.spans:
        if span.kind != "music":
            continue
        beats = [b for b in track.beats if span.start + 2 < b < span.end - 1.5]
        found += [(beats[i], beats[i + 15]) for i in range(0, len(beats) - 15, 16)]
    return found


def _frames(start: float, end: float, count: int) -> NDArray[np.int64]:
    first, last = max(0, round(start * FRAME_RATE_HZ)), min(count, round(end * FRAME_RATE_HZ))
    return np.arange(first, max(first, last))


def _fade(frames: NDArray[np.int64], start: float, end: float) -> Float[np.ndarray, " t"]:
    time = frames / FRAME_RATE_HZ
    x = np.clip(np.minimum(time - start, end - time) / FADE_S, 0, 1)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))
