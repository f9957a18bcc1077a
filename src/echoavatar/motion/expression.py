"""Facial expressions: what a mood adds to the curves that the face model makes from sound. Not in the paper.

An action shows its own mood (`happy` smiles, `sad` frowns), a dancing body smiles, a voice shows what it feels
(`feeling`), and a resting face is friendly. Moods fade into one another. An open mouth weakens what a mood asks of the
lips, so that speech stays readable; what a voice feels does not part them, so that they close on p, b and m.

Happy is made of action units 6 and 12, angry of 4, 7 and 23, sad of 1 and 15 (Ekman and Friesen's EMFACS), and more.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from echoavatar.timing import CHUNK, ChunkSize

from .arkit import ARKIT_NAMES
from .feeling import FEELINGS, Feeling
from .kinematics.easing import smootherstep
from .motion_chunk import KEPT, ChunkFade, MotionChunk

RISE_S, FALL_S = 0.4, 0.7  # to a mood, and out of it
RESTING, DANCING = "resting", "dancing"
SPEAKING_JAW = 0.35  # jawOpen from which on the lips keep least of a mood
LIPS_KEPT = 0.45  # the share of a mood that they keep then

_PAIRS: Mapping[str, Mapping[str, float]] = {  # by mood: curves of both sides, or single ones
    RESTING: {"mouthSmile": 0.1, "cheekSquint": 0.05},
    DANCING: {
        "mouthSmile": 0.5,
        "mouthUpperUp": 0.3,
        "mouthLowerDown": 0.15,
        "cheekSquint": 0.4,
        "eyeSquint": 0.12,
        "browOuterUp": 0.15,
    },
    "happy": {
        "mouthSmile": 0.6,
        "mouthUpperUp": 0.45,
        "mouthLowerDown": 0.3,
        "cheekSquint": 0.65,
        "eyeSquint": 0.25,
        "browOuterUp": 0.2,
    },
    "angry": {"browDown": 0.95, "eyeSquint": 0.4, "noseSneer": 0.5, "mouthPress": 0.4, "mouthFrown": 0.55},
    "sad": {"browInnerUp": 0.8, "mouthFrown": 0.6, "mouthShrugLower": 0.35, "eyeLookDown": 0.3, "eyeSquint": 0.1},
    "thinking": {"browOuterUpRight": 0.55, "browDownLeft": 0.4, "eyeLookUp": 0.4, "mouthPress": 0.3, "mouthLeft": 0.2},
    "agree": {"mouthSmile": 0.45, "browInnerUp": 0.3, "cheekSquint": 0.2},
    "disagree": {"browDown": 0.5, "mouthFrown": 0.4, "mouthPress": 0.3},
    "give_up": {"browInnerUp": 0.5, "browOuterUp": 0.45, "mouthFrown": 0.4, "mouthShrugLower": 0.5},
    "wave": {"mouthSmile": 0.5, "mouthUpperUp": 0.3, "mouthLowerDown": 0.15, "cheekSquint": 0.4, "browOuterUp": 0.2},
    "clap": {"mouthSmile": 0.5, "mouthUpperUp": 0.35, "mouthLowerDown": 0.2, "cheekSquint": 0.5, "browOuterUp": 0.2},
    "look_around": {"browInnerUp": 0.4, "browOuterUp": 0.25, "eyeWide": 0.2},
    "listen": {"mouthSmile": 0.2, "browInnerUp": 0.2},
    "nod": {"mouthSmile": 0.25, "browInnerUp": 0.15},
}
_OPPOSED = (
    ("mouthSmile", "mouthFrown"),
    ("mouthSmile", "browInnerUp"),  # raised inner brows over a smile look worried
    ("browDown", "browInnerUp"),
    ("browDown", "browOuterUp"),
    ("eyeLookDown", "eyeLookUp"),
)
_OF_LIPS = np.array([name.startswith("mouth") for name in ARKIT_NAMES])
_JAW = ARKIT_NAMES.index("jawOpen")


def _row(curves: Mapping[str, float]) -> Float[np.ndarray, " 52"]:
    sides = {f"{name}{side}": value for name, value in curves.items() for side in ("", "Left", "Right")}
    return np.array([sides.get(name, 0) for name in ARKIT_NAMES], np.float32)


MOODS: Mapping[str, Float[np.ndarray, " 52"]] = {mood: _row(curves) for mood, curves in _PAIRS.items()}

_SIDES = np.stack([[_row({name: 1}) for name in pair] for pair in _OPPOSED], 1)
_OWN, _OTHER = np.concatenate([_SIDES, _SIDES[::-1]], 1)
_PARTS = ("mouthUpperUp", "mouthLowerDown", "noseSneer", "eyeLook")  # a felt mood opens no lips and keeps eye contact
_FELT = np.stack([MOODS[name] for name in FEELINGS]) * [not name.startswith(_PARTS) for name in ARKIT_NAMES]


class Expression:
    """The moods of one session."""

    def __init__(self, chunk: ChunkSize = CHUNK, feeling: float = 0.0, voice: Feeling | None = None) -> None:
        """`feeling` is the share of a mood that a sure feeling of the voice shows; `voice` is what was heard so far."""
        self._chunk, self._feeling, self._voice = chunk, feeling, voice or Feeling()
        self._fades = {RESTING: ChunkFade(RISE_S, FALL_S, start=1.0, chunk=chunk)}
        self._strengths: dict[int, dict[str, float]] = {}  # by chunk, so that a chunk that is made again is the same

    def apply(
        self,
        chunk: int,
        motion: MotionChunk,
        *,
        mood: str = RESTING,
        strength: float = 1.0,
        speech: Float[np.ndarray, " s"] | None = None,
    ) -> MotionChunk:
        """A chunk with its mood, resting for a mood that is not in `MOODS`. `strength` 1 is the mood as designed.

        A resting face shows what the voice feels; `speech` is what the avatar says, 24 kHz.
        """
        if motion.face is None:
            return motion
        felt = np.zeros((self._chunk.frames, len(FEELINGS)))
        if speech is not None and self._feeling:
            felt = self._feeling * self._voice.hear(chunk, speech)
        mood = mood if mood in MOODS else RESTING
        self._fades.setdefault(mood, ChunkFade(RISE_S, FALL_S, chunk=self._chunk))
        before = self._strengths.get(chunk - 1, {})
        strengths = self._strengths[chunk] = {**before, mood: min(strength, 1.3)}
        self._strengths.pop(chunk - KEPT, None)
        added = np.zeros((self._chunk.frames, len(ARKIT_NAMES)), np.float32)
        for each, fade in self._fades.items():
            share = smootherstep(fade.shares(chunk, is_wanted=each == mood))
            if each == RESTING:
                added = np.maximum(added, share[:, None] * (felt @ _FELT))
                share = share * (1 - felt.max(1))
            size = strengths.get(each, 1.0)
            sizes = np.linspace(before.get(each, size), size, self._chunk.frames + 1)[1:]
            added = np.maximum(added, (share * sizes)[:, None] * MOODS[each])
        return motion._replace(face=with_mood(motion.face, added[: len(motion.face)]))


def with_mood(face: Float[np.ndarray, "t 52"], added: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 52"]:
    """Curves with those of a mood added, 1 at most; curves that oppose those of the mood get weaker."""
    speaking = np.clip(face[:, _JAW] / SPEAKING_JAW, 0, 1)[:, None]
    added = np.clip(np.where(_OF_LIPS, added * (1 - (1 - LIPS_KEPT) * speaking), added), 0, 1)
    opposed = (added[:, None] * _OTHER).max(2, keepdims=True)
    face = face * (1 - opposed * _OWN).prod(1)
    return np.asarray(face + added * (1 - face), np.float32)
