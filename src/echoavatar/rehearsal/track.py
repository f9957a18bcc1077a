"""Long realistic sound made of speech, music and silence, with all labels; the same seed gives the same samples.

Not in the paper, which trains on recorded corpora.
"""

from dataclasses import replace

import numpy as np

from ..timing import SAMPLE_RATE_HZ
from .augment import add_background, background, fill_band, set_loudness, treat
from .instruments import render
from .music import compose_piece
from .prosody import Delivery
from .script import write_monologue
from .sound import FloatArray, SoundTrack, Span, concatenate, cut, whole_frames
from .speech import draw_speaker, resolve_engine, speak

_MIXES = ("mixed", "speech", "music", "silence")


def compose_track(
    seed: int, seconds: float, mix: str = "mixed", engine: str = "auto", split: str = "train"
) -> SoundTrack:
    """Compose `seconds` of sound (rounded to whole frames), bit-identical for equal arguments.

    `mix` is "mixed", "speech", "music" or "silence"; `engine` "auto", "flite" or "own"; `split` "train" or "test".
    """
    if mix not in _MIXES:
        raise ValueError(f"mix is {mix!r}; one of {', '.join(_MIXES)}")
    rng = np.random.default_rng([seed, _MIXES.index(mix), int(split == "test")])
    tool = resolve_engine(engine) if mix in ("mixed", "speech") else "own"
    level = float(np.clip(rng.normal(-24, 6), -38, -15))
    speaker = draw_speaker(rng, tool) if mix in ("mixed", "speech") else None
    parts: list[SoundTrack] = []
    total, previous = 0.0, ""
    while total < seconds:
        kind = _next_kind(rng, mix, previous)
        if kind == "speech" and speaker is not None:
            if rng.random() < 0.15:
                speaker = draw_speaker(rng, tool)
            part = _speech_part(rng, speaker, tool, split, level)
        elif kind == "music":
            part = _music_part(rng, min(float(rng.uniform(12, 40)), max(6.0, seconds - total + 1)), level)
        else:
            part = _silence_part(rng, level)
        parts.append(part)
        total += part.seconds
        previous = kind
    track = cut(concatenate(parts), seconds)
    return _finish(track, rng)


def _next_kind(rng: np.random.Generator, mix: str, previous: str) -> str:
    """What follows: music usually ends in silence, sometimes speech sets in at once."""
    if mix == "silence":
        return "silence"
    if previous == "silence" or not previous:
        if mix != "mixed":
            return mix if previous or rng.random() < 0.7 else "silence"
        return str(rng.choice(["speech", "music", "silence"], p=[0.58, 0.35, 0.07]))
    if mix == "mixed" and rng.random() < 0.25:
        return "speech" if previous == "music" else "music"
    return "silence"


def _speech_part(
    rng: np.random.Generator, speaker: Delivery, engine: str, split: str, level_db: float
) -> SoundTrack:
    sentences = write_monologue(rng, int(rng.integers(2, 9)), split)
    said = speak(sentences, speaker, rng, engine)
    audio = treat(fill_band(said.audio, rng), rng)
    return replace(said, audio=set_loudness(audio, level_db + float(rng.normal(0, 1.5))))


def _music_part(rng: np.random.Generator, seconds: float, level_db: float) -> SoundTrack:
    piece = compose_piece(rng, seconds)
    audio = treat(render(piece, rng), rng)
    audio = whole_frames(set_loudness(audio, level_db + float(rng.normal(1, 2))))
    end = len(audio) / SAMPLE_RATE_HZ
    return SoundTrack(
        audio=audio,
        spans=(Span(0.0, end, "music"),),
        beats=piece.beats,
        downbeats=piece.downbeats,
        sections=piece.sections,
        style=piece.style,
        bpm=piece.bpm,
    )


def _silence_part(rng: np.random.Generator, level_db: float) -> SoundTrack:
    """Digital zero, or room noise or hum well under the level of the track."""
    samples = round(float(rng.uniform(1, 6)) * SAMPLE_RATE_HZ)
    audio: FloatArray = np.zeros(samples, np.float32)
    if rng.random() < 0.6:
        loud = 10 ** (min(level_db - rng.uniform(22, 45), -42) / 20)
        fade = np.minimum(1, np.arange(samples) / 1200)
        audio = (loud * background(rng, samples) * fade * fade[::-1]).astype(np.float32)
    audio = whole_frames(audio)
    return SoundTrack(audio, spans=(Span(0.0, len(audio) / SAMPLE_RATE_HZ, "silence"),))


def _finish(track: SoundTrack, rng: np.random.Generator) -> SoundTrack:
    """Sometimes quiet noise under the whole track; the labels stay."""
    if rng.random() < 0.35 and any(span.kind != "silence" for span in track.spans):
        track = replace(track, audio=add_background(track.audio, rng, float(rng.uniform(24, 45))))
    return replace(track, audio=np.clip(track.audio, -0.98, 0.98).astype(np.float32))
