"""A speaker's head and torso: nods on stress, turns at phrase borders, shakes on negation, tilts on questions."""

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import Array, air, critically_damped, smoothed, wander
from ..sound import SoundTrack, Syllable

NOD_FROM = 0.45  # least prominence of a syllable that may get a nod


def speech_activity(track: SoundTrack, frames: int) -> Float[Array, " t"]:
    """1 during speech, 0 otherwise, eased over a third of a second."""
    active = np.zeros(frames, np.float32)
    for begin, end in track.phrases:
        active[round(begin * FRAME_RATE_HZ) : round(end * FRAME_RATE_HZ)] = 1
    return critically_damped(smoothed(active, 0.05), 0.35)


def head_accents(
    track: SoundTrack, size: float, rng: np.random.Generator
) -> tuple[Float[Array, "t 3"], Float[Array, "t 3"]]:
    """Offsets (yaw, pitch, roll) to add to head and spine for a whole track; `size` scales the nods."""
    frames = round(track.seconds * FRAME_RATE_HZ)
    head, spine = np.zeros((frames, 3), np.float32), np.zeros((frames, 3), np.float32)
    for syllable in track.syllables:
        if syllable.prominence >= NOD_FROM and rng.random() < 0.35 + 0.6 * syllable.prominence:
            _nod(syllable, size, rng, head, spine)
    for previous, syllable in zip((None, *track.syllables), track.syllables, strict=False):
        if syllable.meaning and (previous is None or previous.word != syllable.word):
            _meaning(syllable, size, rng, head)
    active = speech_activity(track, frames)[:, None]
    head += _addressees(track, frames, rng) * active
    head += wander(frames, 3, period=1.1, rng=rng) * np.array([0.040, 0.026, 0.026]) * active
    spine += wander(frames, 3, period=1.7, rng=rng) * np.array([0.028, 0.016, 0.014]) * active
    return head, spine


def _nod(syllable: Syllable, size: float, rng: np.random.Generator, head: Array, spine: Array) -> None:
    """Move the head down with the vowel and up again. Strong nods take the chest along; some nods go up instead."""
    strength = (0.035 + 0.13 * syllable.prominence**2) * size * float(rng.uniform(0.7, 1.3))
    way = -0.6 if rng.random() < 0.15 else 1.0
    length = float(rng.uniform(0.40, 0.58))
    begin = syllable.vowel - 0.05
    _add(head, 1, begin, length, way * strength)
    _add(head, 2, begin, length * 1.2, float(rng.normal(0, 0.35)) * strength)
    _add(head, 0, begin, length * 1.3, float(rng.normal(0, 0.35)) * strength)
    if syllable.prominence > 0.7:
        _add(spine, 1, begin + 0.03, length * 1.3, 0.35 * way * strength)


def _meaning(syllable: Syllable, size: float, rng: np.random.Generator, head: Array) -> None:
    if syllable.meaning == "negation":
        sign = float(rng.choice([-1, 1]))
        for turn in range(4):
            strength = 0.15 * size * sign * (-1) ** turn * (0.7, 1.0, 0.8, 0.4)[turn]
            _add(head, 0, syllable.start + 0.22 * turn, 0.44, strength)
    elif syllable.meaning == "question":
        _add(head, 2, syllable.start, 1.3, float(rng.choice([-1, 1])) * 0.11 * size)
        _add(head, 1, syllable.start, 1.1, -0.05 * size)
    elif syllable.meaning == "greeting":
        _add(head, 1, syllable.start, 0.6, 0.14 * size)
    elif syllable.meaning == "contrast":
        _add(head, 2, syllable.start, 0.9, float(rng.choice([-1, 1])) * 0.08 * size)


def _addressees(track: SoundTrack, frames: int, rng: np.random.Generator) -> Float[Array, "t 3"]:
    """Turn the head to another addressee, or back to the front, at phrase borders."""
    goal = np.zeros((frames, 3), np.float32)
    for begin, _ in track.phrases:
        first = round((begin - 0.05) * FRAME_RATE_HZ)
        chosen = rng.normal(0, 1, 3) * (0.14, 0.035, 0.05) if rng.random() < 0.65 else np.zeros(3)
        goal[max(first, 0) :] = np.clip(chosen, -0.25, 0.25)
    return critically_damped(smoothed(goal, 0.06), 0.42)


def _add(curve: Array, axis: int, begin: float, seconds: float, size: float) -> None:
    """Add a bump that starts and ends at rest."""
    first = max(int(begin * FRAME_RATE_HZ), 0)
    last = min(int((begin + seconds) * FRAME_RATE_HZ) + 2, len(curve))
    if last > first:
        phase = (np.arange(first, last) / FRAME_RATE_HZ - begin) / seconds
        curve[first:last, axis] += size * air(phase)
