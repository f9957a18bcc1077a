"""`echoavatar evaluate BUNDLE feelings`: whether the face shows what a voice feels.

Acted speech drives the face as in a session in which the speaker said neutral recordings before (`Voices`). Each
recording's curves are averaged over its speech. The face of one speaker is then read by the faces of all the others: as
the feeling whose mean face is nearest, each curve scaled by its deviation. Chance is a quarter.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from echoavatar.engine.pipeline import Bundle
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.models.face import FaceStream
from echoavatar.models.face.idle import frame_loudness
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.expression import Expression
from echoavatar.motion.feeling import Feeling, Memory
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, SAMPLE_RATE_HZ
from echoavatar_lab.foreign.csv_rows import read_rows
from echoavatar_lab.models.audio.recordings import MANIFEST, split_of
from echoavatar_lab.progress import Progress, watched

from .faces import animate_face

NAMES = ("neutral", "happy", "angry", "sad")
_WORDS = {
    **dict.fromkeys(("neutral",), 0),
    **dict.fromkeys(("happy", "happiness", "joy"), 1),
    **dict.fromkeys(("angry", "anger"), 2),
    **dict.fromkeys(("sad", "sadness"), 3),
}
SHOWN = ("mouthSmile", "mouthFrown", "browDown", "browInnerUp", "browOuterUp", "eyeSquint")  # means of both sides
QUIET = 0.25  # of loudness under a recording's loudest frame (15 dB): not speech
PAUSE_S = 1.0  # after each recording that was heard before
LEAST = 0.02  # deviation of a curve: smaller differences are not seen


class ActedSpeech(NamedTuple):
    """A recording of acted speech."""

    path: Path
    feeling: int  # its place in `NAMES`
    speaker: str
    split: str  # of the folder's manifest; "other" without one


class Reading(NamedTuple):
    """What is read in the faces of one split."""

    confusion: Int[np.ndarray, "4 4"]  # recordings by what was acted and what was read
    faces: Float[np.ndarray, "4 52"]  # mean curves by what was acted; NaN where there is none

    @property
    def right(self) -> float:
        """The mean over what was acted of the share that was read as it."""
        count = self.confusion.sum(1)
        return float(np.mean(np.diag(self.confusion)[count > 0] / count[count > 0]))


def acted_speech(folder: Path) -> list[ActedSpeech]:
    """Recordings below a folder whose title in a manifest.csv, or else whose file's name, has the word of a feeling.

    The speaker is that of the manifest, else the first word of the name.

    Raises:
        EchoAvatarError: there are not two speakers.
    """
    rows: dict[Path, dict[str, str]] = {}
    for manifest in folder.rglob(MANIFEST):
        rows |= {manifest.parent / row["path"]: row for row in read_rows(manifest) if row.get("path")}
    found = []
    for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in SOUND_SUFFIXES):
        row = rows.get(path, {})
        if row.get("kind", "speech") != "speech":
            continue
        words = re.findall(r"[a-z]+", (row.get("title") or path.stem).lower())
        feelings = {_WORDS[word] for word in words if word in _WORDS}
        if len(feelings) == 1:
            speaker = row.get("speaker_or_artist") or words[0]
            found.append(ActedSpeech(path, feelings.pop(), speaker, split_of(speaker, row.get("split") or "other")))
    if len({each.speaker for each in found}) < 2:
        raise EchoAvatarError(
            f"{folder} has no acted speech of two speakers: a file's name, or its title in {MANIFEST}, says neutral, "
            "happy, angry or sad"
        )
    return found


class Voices:
    """What sessions heard before a recording: every second neutral one of the speaker, from which feelings differ.

    Before those, the others were heard.
    """

    def __init__(self, speech: Sequence[ActedSpeech]) -> None:
        self._neutral: dict[str, list[Path]] = {}
        for each in speech:
            if each.feeling == 0:
                self._neutral.setdefault(each.speaker, []).append(each.path)
        self._heard: dict[tuple[str, int], Memory] = {}

    def before(self, each: ActedSpeech) -> Memory:
        """The memory of a voice before this recording."""
        neutral = self._neutral.get(each.speaker, [])
        half = 1 - neutral.index(each.path) % 2 if each.feeling == 0 else 0
        if (each.speaker, half) not in self._heard:
            voice, pause = Feeling(), np.zeros(round(PAUSE_S * SAMPLE_RATE_HZ), np.float32)
            said = np.concatenate([pause, *(part for path in neutral[half::2] for part in (read_audio(path), pause))])
            for number in range(count := len(said) // CHUNK_SAMPLES):
                voice.hear(number, said[number * CHUNK_SAMPLES : (number + 1) * CHUNK_SAMPLES])
            self._heard[each.speaker, half] = voice.memories[count - 1]
        return self._heard[each.speaker, half]


def read_feelings(
    bundle: Bundle, speech: Sequence[ActedSpeech], *, seed: int = 0, progress: Progress | None = None
) -> dict[str, Reading]:
    """What is read in the bundle's faces, by split.

    Raises:
        EchoAvatarError: the bundle has no face model.
    """
    if bundle.face is None:
        raise EchoAvatarError(f"bundle {bundle.name} has no face model; train one (`echoavatar train face`)")
    stream, voices, rows = bundle.face.stream(), Voices(speech), []
    for each in watched(speech, progress):
        rows.append(mean_face(stream, read_audio(each.path), voices.before(each), seed=seed))
    faces, felt = np.array(rows), np.array([each.feeling for each in speech])
    speakers, splits = (np.array([each[at] for each in speech]) for at in (2, 3))
    guessed = np.zeros(len(felt), int)
    for speaker in set(speakers):
        own, others = speakers == speaker, speakers != speaker
        scale = np.maximum(faces[others].std(0), LEAST)
        means = [faces[others & (felt == kind)].mean(0) if (felt[others] == kind).any() else None for kind in range(4)]
        away = [np.inf if m is None else np.square((faces[own] - m) / scale).sum(1) for m in means]
        guessed[own] = np.argmin(np.stack(np.broadcast_arrays(*away)), 0)
    found = {}
    for split in dict.fromkeys(splits):
        table, inside = np.zeros((4, 4), int), splits == split
        np.add.at(table, (felt[inside], guessed[inside]), 1)
        kinds = [faces[inside & (felt == kind)] for kind in range(4)]
        found[str(split)] = Reading(table, np.array([k.mean(0) if len(k) else np.full(52, np.nan) for k in kinds]))
    return found


def mean_face(
    stream: FaceStream, audio: Float[np.ndarray, " s"], before: Memory | None = None, *, seed: int = 0
) -> Float[np.ndarray, " 52"]:
    """Curves as a session shows them at rest, averaged over the frames of speech."""
    audio = np.pad(audio, (0, -len(audio) % CHUNK_SAMPLES)).astype(np.float32)
    curves = animate_face(stream, audio, seed=seed)
    expression, made = Expression(feeling=MotionOptions().feeling, voice=Feeling(before)), []
    for number, speech in enumerate(audio.reshape(-1, CHUNK_SAMPLES)):
        face = curves[number * CHUNK_FRAMES : (number + 1) * CHUNK_FRAMES]
        motion = MotionChunk(np.zeros((CHUNK_FRAMES, 1, 4), np.float32), np.zeros((CHUNK_FRAMES, 3), np.float32), face)
        made.append(np.asarray(expression.apply(number, motion, speech=speech).face))
    loud = frame_loudness(audio[None])[0]
    return np.asarray(np.concatenate(made)[loud > loud.max() - QUIET].mean(0))


def as_text(readings: dict[str, Reading]) -> str:
    """A table of what was read for each split, and the means of the curves that show feelings."""
    lines = []
    for split, (confusion, faces) in readings.items():
        lines.append(f"{split}: {readings[split].right:.0%} right (chance 25%)")
        heads = [f"{'read ' + name:>14}" for name in NAMES] + [f"{name:>13}" for name in SHOWN]
        lines.append(f"{'acted':<10}" + "".join(heads))
        for name, row, face in zip(NAMES, confusion, faces, strict=True):
            means = [f"{face[_columns(curve)].mean():>13.2f}" for curve in SHOWN]
            lines.append(f"{name:<10}" + "".join([f"{count:>14}" for count in row] + means))
    return "\n".join(lines)


def _columns(name: str) -> list[int]:
    return [at for at, each in enumerate(ARKIT_NAMES) if each in (name, f"{name}Left", f"{name}Right")]
