"""Speech and music of a rehearsal track from a folder of recordings, with the labels that `recording_labels` finds.

Low and high voices are drawn equally often, and a speaker by the root of how long he is heard. Music is labelled once,
whole and clean; a track gets a stretch of it, often at another pitch and tempo. Not in the paper.
"""

from collections import defaultdict
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import soxr

from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.models.audio.recordings import RecordedFile, decoded, recorded_files

from ..sound import FloatArray, SoundTrack, Source, concatenate, cut, shift, whole_frames
from ..speech.speech import draw_pause, silence
from .recording_labels import is_low_voice, track_from_recording

_LONGEST_UTTERANCE_S = 14.0
_SHORTEST_LOOP_S = 24.0  # shorter pieces are loops; they are played several times
_ANOTHER_VOICE = 0.15  # chance after each utterance
# Words of a manifest's genres and the style of dance; a genre with none of them is danced to by its tempo.
_STYLES = {
    "hip-hop": "hip_hop", "breakbeat": "hip_hop", "funk": "pop", "boogie": "pop", "pop": "pop", "rave": "house",
    "techno": "house", "trance": "house", "dance electronic": "house", "rock": "rock", "metal": "rock",
    "swing": "swing", "ragtime": "swing", "waltz": "waltz", "march": "march", "latin": "salsa", "salsa": "salsa",
}  # fmt: skip


class RecordedSound:
    """Draws speech and music from the recordings of one split."""

    def __init__(self, folder: Path, split: str) -> None:
        """Raises AudioError if the folder holds no recordings of the split, or a damaged manifest."""
        files = recorded_files(folder, split)
        self.music_files = [file for file in files if file.kind == "music"]
        voices: dict[tuple[str, str], list[RecordedFile]] = defaultdict(list)
        for file in files:
            if file.kind == "speech":
                voices[file.style, file.voice or file.title].append(file)
        self.voices = list(voices.values())
        heard = np.array([sum(max(file.seconds, 1.0) for file in voice) for voice in self.voices])
        self._chances = np.sqrt(heard) / np.sqrt(heard).sum()  # between a turn each and a second each

    def speech(self, rng: np.random.Generator, seconds: float) -> SoundTrack:
        """About `seconds` of speech with pauses, mostly by one speaker; begins and ends with speech."""
        parts: list[SoundTrack] = []
        voice: list[RecordedFile] = []
        while not parts or sum(part.seconds for part in parts) < seconds - 1:
            if not voice or rng.random() < _ANOTHER_VOICE:
                voice = self._draw_voice(rng)
            parts += [silence(draw_pause(rng))] if parts else []
            parts.append(_utterance(voice[rng.integers(len(voice))], rng))
        return concatenate(parts)

    def music(self, rng: np.random.Generator, seconds: float) -> SoundTrack:
        """At most `seconds` of a piece; half of the stretches begin on a downbeat, most change pitch and tempo."""
        file = self.music_files[rng.integers(len(self.music_files))]
        piece = _labelled_music(file)
        factor = float(2 ** (rng.uniform(-2, 2) / 12)) if rng.random() < 0.6 else 1.0
        latest = max(0.0, piece.seconds - seconds / factor)
        start = float(rng.uniform(0, latest))
        downbeats = piece.downbeats[piece.downbeats <= latest]
        if len(downbeats) and rng.random() < 0.5:
            start = float(rng.choice(downbeats))
        part = cut(piece, seconds / factor, start)
        fade = np.minimum(1, np.arange(len(part.audio)) / 240).astype(np.float32)
        audio = part.audio.astype(np.float32) / 32_768 * fade * fade[::-1]
        if factor != 1.0:
            part, audio = shift(part, 0.0, factor), _resampled(audio, factor)
        part = cut(replace(part, audio=whole_frames(audio)), len(audio) / SAMPLE_RATE_HZ)
        style = next((name for word, name in _STYLES.items() if word in file.style.lower()), "recording")
        return replace(
            part, style=style, sources=(Source(0.0, part.seconds, "music", _named(file), file.style or "recorded"),)
        )

    def _draw_voice(self, rng: np.random.Generator) -> list[RecordedFile]:
        """A speaker; low and high voices are equally likely."""
        is_low = rng.random() < 0.5
        for _ in range(12):
            voice = self.voices[int(rng.choice(len(self.voices), p=self._chances))]
            if _is_low(voice[0].path, voice[0].voice) == is_low:
                return voice
        return voice


def _utterance(file: RecordedFile, rng: np.random.Generator) -> SoundTrack:
    """A short file as it is, or a stretch of a longer one, cut where it is quiet."""
    sound = decoded(file.path)
    wanted = int(rng.uniform(4, _LONGEST_UTTERANCE_S) * SAMPLE_RATE_HZ)
    if len(sound) > _LONGEST_UTTERANCE_S * SAMPLE_RATE_HZ:
        start = _quiet_near(sound, int(rng.integers(0, len(sound) - wanted)))
        sound = sound[start : _quiet_near(sound, start + wanted)]
    audio = sound.astype(np.float32) / 32_768
    fade = np.minimum(1, np.arange(len(audio)) / 480).astype(np.float32)
    missing = max(0, SAMPLE_RATE_HZ - len(audio))
    said = track_from_recording(np.pad(audio * fade * fade[::-1], (0, missing)), "speech")
    return replace(said, sources=(Source(0.0, said.seconds, "speech", _named(file), file.style or "recorded"),))


def _quiet_near(sound: np.ndarray, sample: int) -> int:
    """The middle of the quietest 60 ms within a second of a sample; the ends of the sound count as quiet."""
    first = max(0, sample - SAMPLE_RATE_HZ)
    part = np.asarray(sound[first : sample + SAMPLE_RATE_HZ], np.float64)
    if first == 0 or sample + SAMPLE_RATE_HZ >= len(sound):
        return 0 if first == 0 else len(sound)
    power = np.convolve(part**2, np.ones(1440), mode="valid")
    return first + 720 + int(np.argmin(power))


@cache
def _labelled_music(file: RecordedFile) -> SoundTrack:
    """A whole piece with its beats, in 16 bit, so that it need not be in memory; short loops several times over."""
    sound = decoded(file.path)
    is_loop = len(sound) < _SHORTEST_LOOP_S * SAMPLE_RATE_HZ and "loop" in f"{file.title} {file.style}".lower()
    loop_s = len(sound) / SAMPLE_RATE_HZ if is_loop else 0.0
    times = int(np.ceil(_SHORTEST_LOOP_S * SAMPLE_RATE_HZ / len(sound)))
    sound = np.tile(sound, times) if times > 1 else sound
    return replace(track_from_recording(sound.astype(np.float32) / 32_768, "music", loop_s=loop_s), audio=sound)


@cache
def _is_low(path: Path, name: str) -> bool:
    """Whether a voice is low: as its name says, "(M, ...)" or "(f)", otherwise by its pitch."""
    sex = next((part[0].lower() for part in name.split("(")[1:] if part[:1].lower() in "mf"), "")
    return sex == "m" if sex else is_low_voice(decoded(path)[: 20 * SAMPLE_RATE_HZ].astype(np.float32))


def _resampled(audio: FloatArray, factor: float) -> FloatArray:
    """`factor` times as long and as many times lower."""
    return np.asarray(soxr.resample(audio, SAMPLE_RATE_HZ, SAMPLE_RATE_HZ * factor, quality="MQ"), np.float32)


def _named(file: RecordedFile) -> str:
    return ": ".join(part for part in (file.voice, file.title) if part)
