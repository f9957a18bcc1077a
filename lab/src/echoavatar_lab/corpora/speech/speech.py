"""Speech with known labels: script sentences spoken by flite or by the built-in formant synthesiser.

Engine "auto" uses flite where it is installed, "flite" raises DependencyError where it is not, "own" is the built-in
one. Pauses between breath groups are digital silence. Not in the paper.
"""

import numpy as np

from echoavatar.errors import DependencyError
from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray, SoundTrack, Span, Syllable, bridged, concatenate, whole_frames
from .flite import VOICES, flite
from .formant import FORMANT_VOICES
from .formant import say as formant_say
from .prosody import Delivery, Utterance, draw_delivery
from .script import Sentence, Word

PHRASE_GAP_S = 0.15  # a shorter pause does not end a phrase


def resolve_engine(engine: str) -> str:
    """The engine that "auto", "flite" or "own" means on this machine: "flite" or "own"."""
    if engine == "own":
        return "own"
    try:
        flite()
    except DependencyError:
        if engine == "flite":
            raise
        return "own"
    return "flite"


def draw_speaker(rng: np.random.Generator, engine: str) -> Delivery:
    """A random speaker of the engine "flite" or "own"."""
    return draw_delivery(rng, VOICES if engine == "flite" else FORMANT_VOICES)


def speak(sentences: tuple[Sentence, ...], speaker: Delivery, rng: np.random.Generator, engine: str) -> SoundTrack:
    """Speak sentences in turn with short pauses; the track begins and ends with speech."""
    tracks: list[SoundTrack] = []
    for sentence in sentences:
        for group in _breaths(sentence):
            if tracks:
                tracks.append(silence(draw_pause(rng)))
            seed = int(rng.integers(2**31))
            said = flite().say(group, speaker, seed) if engine == "flite" else formant_say(group, speaker, seed)
            tracks.append(_as_track(said, group))
    return concatenate(tracks)


def draw_pause(rng: np.random.Generator) -> float:
    """Seconds of a pause: mostly short, sometimes longer, rarely very long."""
    low, high = ((0.25, 0.6), (0.6, 1.6), (1.6, 4.0))[rng.choice(3, p=[0.55, 0.35, 0.1])]
    return float(rng.uniform(low, high))


def silence(seconds: float) -> SoundTrack:
    """Digital silence inside speech; its span is "speech" if it is shorter than 0.7 s."""
    audio = whole_frames(np.zeros(round(seconds * SAMPLE_RATE_HZ), np.float32))
    return SoundTrack(audio, spans=(Span(0.0, len(audio) / SAMPLE_RATE_HZ, "speech" if seconds < 0.7 else "silence"),))


def _breaths(sentence: Sentence) -> list[tuple[Word, ...]]:
    """Split a sentence after words that ask for a pause."""
    groups: list[list[Word]] = [[]]
    for word in sentence.words:
        groups[-1].append(word)
        if word.pause:
            groups.append([])
    return [tuple(group) for group in groups if group]


def _as_track(said: Utterance, words: tuple[Word, ...]) -> SoundTrack:
    audio: FloatArray = whole_frames(said.audio)
    syllables = tuple(
        Syllable(s.start, s.end, s.vowel, s.prominence, words[s.word].text, words[s.word].meaning)
        for s in said.syllables
    )
    spoken = [(start, end) for start, end, name in said.phones if name != "pau"]
    return SoundTrack(
        audio=audio,
        spans=(Span(0.0, len(audio) / SAMPLE_RATE_HZ, "speech"),),
        syllables=syllables,
        phrases=tuple(bridged(spoken, PHRASE_GAP_S)),
        phones=said.phones,
    )
