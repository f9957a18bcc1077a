"""Recorded clips blended into the synthetic motion, warped in time so that strokes meet stresses and hits meet beats.

Some phrases and some stretches of sixteen beats take torso, head, arms and (if they move) fingers from a recorded clip.
Legs stay synthetic, because recorded feet would slide at another tempo. The file name of a clip tells whether it is
speech or dance; other clips are left out.
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

from echoavatar.errors import MotionError
from echoavatar.models.fingers import load_shipped, refine_fingers
from echoavatar.motion.kinematics import HUMANOID, Motion, read_bvh
from echoavatar.motion.kinematics.resample import align_signs, resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_multiply,
    slerp,
)
from echoavatar.timing import FRAME_RATE_HZ

from .sound import SoundTrack

Array = np.ndarray
SPEECH_NAMES = ("talk", "conversation")
DANCE_NAMES = ("dance",)
STROKE_DELAY_S = 0.14  # from the stressed vowel to the end of the stroke, as in `gesture_cues`
FADE_S = 0.5
SMOOTHING_FRAMES = 1.35
MAX_SPEED_DEG_S = 850.0  # no clip is sped up beyond this joint speed
SPEECH_SHARE, DANCE_SHARE = 0.35, 0.3  # of phrases and of sixteen-beat stretches
RATES = (0.7, 1.45)  # least and greatest playback rate of a clip


@dataclass(frozen=True)
class RecordedClip:
    """A recorded clip on our rig, with the times that should coincide with stresses or beats."""

    name: str
    kind: Literal["speech", "dance"]
    motion: Motion
    accents: Float[np.ndarray, " n"]  # seconds: ends of strokes, or the hits of a dance
    fastest: float  # highest joint speed, degrees per second
    has_fingers: bool


@dataclass(frozen=True)
class Library:
    """Recorded clips by the kind of sound they go with."""

    speech: tuple[RecordedClip, ...]
    dance: tuple[RecordedClip, ...]


def load_library(folder: Path, *, is_refined: bool = False) -> Library:
    """Read, retarget and resample every usable BVH below `folder`; with `is_refined`, frozen hands get new fingers.

    Raises:
        MotionError: the folder holds no usable file, or one is damaged.
    """
    clips = [_load_clip(path, is_refined) for path in sorted(folder.rglob("*.bvh")) if _kind(path.stem)]
    if not clips:
        wanted = ", ".join(SPEECH_NAMES + DANCE_NAMES)
        raise MotionError(f"{folder} holds no BVH whose name contains one of: {wanted}; give another --library")
    by_kind = {kind: tuple(clip for clip in clips if clip.kind == kind) for kind in ("speech", "dance")}
    return Library(by_kind["speech"], by_kind["dance"])


def blend_recordings(library: Library, track: SoundTrack, motion: Motion, seed: int) -> Motion:
    """The same motion with recorded stretches blended in; deterministic for a seed."""
    rng = np.random.default_rng([seed, 0x11B])
    rotations = motion.rotations.copy()
    if library.speech:
        for start, end in track.phrases:
            if end - start > 1.2 and rng.random() < SPEECH_SHARE:
                _blend_phrase(library.speech[rng.integers(len(library.speech))], track, start, end, rotations, rng)
    if library.dance:
        for start, end in _stretches(track):
            if rng.random() < DANCE_SHARE:
                clip = library.dance[rng.integers(len(library.dance))]
                _blend_dance(clip, np.asarray(track.beats), start, end, rotations)
    return replace(motion, rotations=rotations)


def _kind(name: str) -> Literal["speech", "dance"] | None:
    if any(word in name for word in DANCE_NAMES):
        return "dance"
    return "speech" if any(word in name for word in SPEECH_NAMES) else None


def _load_clip(path: Path, is_refined: bool) -> RecordedClip:
    kind = _kind(path.stem)
    assert kind is not None
    motion = resample(retarget(read_bvh(path)), FRAME_RATE_HZ)
    if is_refined:
        motion = refine_fingers(load_shipped(), motion, hands="frozen")
    motion = _denoised(motion, is_loop=kind == "dance")
    fingers = motion.rotations[:, list(HUMANOID.config.parts["hands"])]
    upper = torch.from_numpy(motion.rotations[:, list(HUMANOID.config.parts["upper"])])
    turned = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(upper[:-1]), upper[1:]))
    fastest = float(torch.rad2deg(turned.norm(dim=-1)).max()) * FRAME_RATE_HZ
    has_fingers = bool(np.abs(np.diff(fingers, axis=0)).max(initial=0) > 1e-3)
    return RecordedClip(path.stem, kind, motion, _accents(motion, kind), fastest, has_fingers)


def _denoised(motion: Motion, *, is_loop: bool) -> Motion:
    """The motion without capture noise, which looks like trembling; loops are smoothed across their seam."""
    rotations = align_signs(motion.rotations).astype(np.float64)
    if is_loop:
        rotations = _seamless(rotations)
    rotations = gaussian_filter1d(rotations, SMOOTHING_FRAMES, axis=0, mode="wrap" if is_loop else "nearest")
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    return replace(motion, rotations=rotations.astype(np.float32))


def _seamless(rotations: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """Close the loop: spread the gap between the last and the first frame over the second half."""
    gap = rotations[0] - (2 * rotations[-1] - rotations[-2])
    closes = (rotations[0] * rotations[-1]).sum(-1, keepdims=True) > 0  # not for a joint that made a full turn
    rise = np.clip((np.arange(len(rotations)) / len(rotations) - 0.5) * 2, 0, 1) ** 2
    return rotations + rise[:, None, None] * np.where(closes, gap, 0)


def _accents(motion: Motion, kind: str) -> Float[np.ndarray, " n"]:
    """Times of strongest deceleration: of the wrists for speech (ends of strokes), of the whole body for dance."""
    positions = gaussian_filter1d(motion.pose().positions.numpy(), 1.0, axis=0, mode="nearest")
    joints = HUMANOID.indices(("leftHand", "rightHand")) if kind == "speech" else list(range(HUMANOID.joints))
    speed = np.linalg.norm(np.diff(positions[:, joints] - positions[:, :1], axis=0), axis=-1).mean(1)
    braking = -np.diff(speed)
    at = find_peaks(braking, height=np.percentile(braking, 75), distance=6)[0]
    return np.asarray((at + (3.0 if kind == "speech" else 1.5)) / FRAME_RATE_HZ)


def _blend_phrase(
    clip: RecordedClip, track: SoundTrack, start: float, end: float, rotations: Array, rng: np.random.Generator
) -> None:
    """Blend a stretch of the clip into the upper body during a phrase."""
    stress = [s.vowel + STROKE_DELAY_S for s in track.syllables if s.prominence >= 0.45 and start <= s.vowel <= end]
    length = end - start + 2 * FADE_S
    latest = clip.motion.seconds - length * RATES[1]
    if latest <= 0:
        return
    source_start = float(rng.uniform(0, latest))
    warp = _warp(clip.accents, np.array(stress), start - FADE_S, end + FADE_S, source_start)
    frames = _frames(start - FADE_S, end + FADE_S, len(rotations))
    source = np.clip(warp(frames / FRAME_RATE_HZ), 0, clip.motion.seconds - 0.05)
    _mix(rotations, frames, clip, source, _fade(frames, start - FADE_S, end + FADE_S))


def _blend_dance(
    clip: RecordedClip, beats: Float[np.ndarray, " n"], start: float, end: float, rotations: Array
) -> None:
    """Blend the looped clip into the upper body so that a loop takes whole beats; do nothing if no tempo fits."""
    inside = beats[(beats >= start - 1e-6) & (beats <= end + 1e-6)]
    loop, beat = clip.motion.seconds, float(np.median(np.diff(inside)))
    fastest_rate = min(RATES[1], MAX_SPEED_DEG_S / clip.fastest)
    counts = [n for n in (1, 2, 3, 4, 6, 8, 12, 16) if RATES[0] < loop / (n * beat) < fastest_rate]
    if not counts:
        return
    step = loop / min(counts, key=lambda n: abs(np.log(loop / (n * beat))))
    times = np.concatenate([[inside[0] - beat], inside, [inside[-1] + beat]])
    places = _best_phase(clip.accents, step) + step * (np.arange(len(times)) - 1)
    frames = _frames(start, end, len(rotations))
    source = PchipInterpolator(times, places, extrapolate=True)(frames / FRAME_RATE_HZ) % loop
    _mix(rotations, frames, clip, source, _fade(frames, start, end))


def _warp(
    accents: Float[np.ndarray, " n"], targets: Float[np.ndarray, " m"], start: float, end: float, source_start: float
) -> PchipInterpolator:
    """Map from track time to clip time that moves accents onto targets within the allowed playback rates."""
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
    clip: RecordedClip,
    source: Float[np.ndarray, " t"],
    weight: Float[np.ndarray, " t"],
) -> None:
    """Slerp torso, head, arms and moving fingers towards the clip at its times `source`."""
    joints = list(HUMANOID.config.parts["upper"])
    if clip.has_fingers:
        joints += list(HUMANOID.config.parts["hands"])
    grid = np.ix_(frames, np.array(joints))
    share = torch.from_numpy(np.repeat(weight[:, None], len(joints), 1).astype(np.float32))
    turned = torch.from_numpy(_sampled(clip.motion, source)[:, joints])
    out[grid] = slerp(torch.from_numpy(out[grid]), turned, share).numpy()


def _sampled(motion: Motion, times: Float[np.ndarray, " t"]) -> Array:
    """Rotations of a motion at any times, by slerp; the last frame leads back to the first."""
    at = times * motion.fps
    low = np.floor(at).astype(int) % motion.frames
    high = (low + 1) % motion.frames
    share = torch.from_numpy((at - np.floor(at)).astype(np.float32))[:, None].expand(-1, motion.skeleton.joints)
    a, b = torch.from_numpy(motion.rotations[low]), torch.from_numpy(motion.rotations[high])
    return slerp(a, b, share).numpy()


def _best_phase(accents: Float[np.ndarray, " n"], step: float) -> float:
    """Where in the clip a beat should lie: the circular mean of the accents modulo the beat."""
    if not len(accents):
        return 0.0
    angle = np.angle(np.exp(2j * np.pi * accents / step).mean())
    return float(angle / (2 * np.pi) * step % step)


def _stretches(track: SoundTrack) -> Sequence[tuple[float, float]]:
    """Stretches of sixteen beats of music, at a distance from its start and end."""
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
