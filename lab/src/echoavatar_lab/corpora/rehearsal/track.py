"""Long tracks of speech, music and silence with all labels; deterministic for a seed.

Not in the paper, which trains on recorded corpora.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from ..music.instruments import render
from ..music.music import compose_piece
from ..music.soundfont import render_soundfont
from ..sound import (
    FloatArray,
    Section,
    SoundTrack,
    Source,
    Span,
    TimeArray,
    concatenate,
    cut,
    merge_spans,
    shift,
    whole_frames,
)
from ..speech.prosody import Delivery
from ..speech.script import write_monologue
from ..speech.singing import sing
from ..speech.speech import draw_speaker, resolve_engine, speak
from .augment import add_background, background, fill_band, set_loudness, treat
from .recorded_sound import RecordedSound

_MIXES = ("mixed", "speech", "music")
_SHARES = (0.0, 0.0, 0.5, 1.0, 1.0)  # of recorded parts in a track
_recorded_sound = cache(RecordedSound)  # a folder is read once in a process
_SUNG = 0.2  # chance that a synthetic voice sings over music, if there are recordings


def compose_track(
    seed: int,
    seconds: float,
    mix: str = "mixed",
    engine: str = "auto",
    split: str = "train",
    soundfont: Path | None = None,
    recordings: Path | None = None,
) -> SoundTrack:
    """Compose `seconds` of sound (rounded to whole frames); equal arguments give identical samples.

    `mix` is "mixed", "speech" or "music"; `engine` (of speech) is "auto", "flite" or "own"; `split` (of the
    scripts) is "train" or "test". With a `soundfont`, fluidsynth plays half of the music. With a folder of
    `recordings`, half of the sound comes from those that are marked "train", in either split.

    Raises DependencyError if a requested engine or player is missing, AudioError if the recordings cannot be read.
    """
    if mix not in _MIXES:
        raise ValueError(f"mix is {mix!r}; one of {', '.join(_MIXES)}")
    rng = np.random.default_rng([seed, _MIXES.index(mix), int(split == "test")])
    settings = _TrackSettings(
        rng=rng,
        engine=resolve_engine(engine) if mix in ("mixed", "speech") else "own",
        split=split,
        level_db=float(np.clip(rng.normal(-25, 6), -40, -14)),
        soundfont=soundfont,
        recorded=_recorded_sound(recordings, "train") if recordings else None,
        share=float(rng.choice(_SHARES)) if recordings else 0.0,
    )
    speaker = draw_speaker(rng, settings.engine)
    parts: list[SoundTrack] = []
    total, previous = 0.0, ""
    while total < seconds:
        kind = _next_kind(rng, mix, previous)
        if rng.random() < 0.1:
            speaker = draw_speaker(rng, settings.engine)
        length = min(float(rng.uniform(12, 40)), max(6.0, seconds - total + 1))
        if kind == "both":
            part = _speech_over_music(settings, speaker, length)
        elif kind == "speech":
            part = _speech_part(settings, speaker)
        else:
            part = _music_part(settings, length) if kind == "music" else _silence_part(settings)
        parts.append(part)
        total += part.seconds
        previous = kind
    return _finish(cut(concatenate(parts), seconds), rng)


@dataclass(frozen=True)
class _TrackSettings:
    """What all parts of one track share."""

    rng: np.random.Generator
    engine: str
    split: str
    level_db: float
    soundfont: Path | None
    recorded: RecordedSound | None
    share: float  # of recorded parts


def _next_kind(rng: np.random.Generator, mix: str, previous: str) -> str:
    """The kind of the next part: after sound usually silence; "both" is speech over music."""
    if previous in ("silence", ""):
        if mix != "mixed":
            return mix if previous or rng.random() < 0.7 else "silence"
        return str(rng.choice(["speech", "music", "both", "silence"], p=[0.54, 0.33, 0.08, 0.05]))
    if mix == "mixed" and rng.random() < 0.25:
        return "speech" if previous == "music" else "music"
    return "silence"


def _speech_part(settings: _TrackSettings, speaker: Delivery) -> SoundTrack:
    rng = settings.rng
    if settings.recorded and settings.recorded.voices and rng.random() < settings.share:
        said = settings.recorded.speech(rng, float(rng.uniform(6, 25)))
    else:
        said = speak(write_monologue(rng, int(rng.integers(2, 9)), settings.split), speaker, rng, settings.engine)
        said = replace(said, sources=(Source(0.0, said.seconds, "speech", speaker.voice, "synthetic"),))
    audio = treat(fill_band(said.audio, rng), rng)
    return replace(said, audio=set_loudness(audio, settings.level_db + float(rng.normal(0, 1.5))))


def _music_part(settings: _TrackSettings, seconds: float) -> SoundTrack:
    rng = settings.rng
    if settings.recorded and settings.recorded.music_files and rng.random() < settings.share:
        music = settings.recorded.music(rng, seconds)
    else:
        music = _composed_part(settings, seconds)
    if settings.recorded and rng.random() < _SUNG and len(music.beats) > 4:
        voice, sung = sing(music.audio, music.beats, rng)
        level = 10 ** (float(rng.uniform(-4, 4)) / 20) * float(np.std(music.audio)) / max(float(np.std(voice)), 1e-6)
        music = replace(music, audio=music.audio + level * voice, sources=(*music.sources, sung))
    audio = treat(music.audio, rng)
    return replace(music, audio=whole_frames(set_loudness(audio, settings.level_db + float(rng.normal(1, 2)))))


def _composed_part(settings: _TrackSettings, seconds: float) -> SoundTrack:
    rng = settings.rng
    piece = compose_piece(rng, seconds)
    if settings.soundfont is not None and rng.random() < 0.5:
        audio, player = render_soundfont(piece, rng, settings.soundfont), settings.soundfont.name
    else:
        audio, player = render(piece, rng), "synthetic"
    audio = whole_frames(audio)
    return SoundTrack(
        audio=audio,
        spans=(Span(0.0, len(audio) / SAMPLE_RATE_HZ, "music"),),
        beats=piece.beats,
        downbeats=piece.downbeats,
        sections=piece.sections,
        style=piece.style,
        bpm=piece.bpm,
        sources=(Source(0.0, len(audio) / SAMPLE_RATE_HZ, "music", player, piece.style),),
    )


def _speech_over_music(settings: _TrackSettings, speaker: Delivery, seconds: float) -> SoundTrack:
    """Speech over music that ducks by 12-20 dB; the louder sound gives the label."""
    rng = settings.rng
    said = _speech_part(settings, speaker)
    lead = int(rng.integers(0, 5 * 30)) * SAMPLES_PER_FRAME
    music = _music_part(settings, max(seconds, said.seconds + lead / SAMPLE_RATE_HZ + float(rng.uniform(1, 6))))
    length = max(len(music.audio), lead + len(said.audio))
    start, stop = lead / SAMPLE_RATE_HZ, (lead + len(said.audio)) / SAMPLE_RATE_HZ
    bed = np.zeros(length, np.float32)
    bed[: len(music.audio)] = music.audio
    time = np.arange(length) / SAMPLE_RATE_HZ
    outside = np.clip(np.maximum(start - time, time - stop) / 0.3, 0, 1)
    gain = 10 ** (-float(rng.uniform(12, 20)) / 20 * (1 - outside))
    audio = (bed * gain).astype(np.float32)
    audio[lead : lead + len(said.audio)] += said.audio
    voice = shift(said, start)
    end = length / SAMPLE_RATE_HZ
    return replace(
        voice,
        audio=audio,
        spans=merge_spans([Span(0.0, start, "music"), Span(start, stop, "speech"), Span(stop, end, "music")]),
        beats=_outside(music.beats, start, stop),
        downbeats=_outside(music.downbeats, start, stop),
        sections=_sections_outside(music.sections, start, stop),
        style=music.style,
        bpm=music.bpm,
        sources=(*voice.sources, *music.sources),
    )


def _outside(times: TimeArray, start: float, stop: float) -> TimeArray:
    return times[(times < start) | (times >= stop)]


def _sections_outside(sections: tuple[Section, ...], start: float, stop: float) -> tuple[Section, ...]:
    before = [replace(s, end=min(s.end, start)) for s in sections if s.start < start]
    after = [replace(s, start=max(s.start, stop)) for s in sections if s.end > stop]
    return tuple(before + after)


def _silence_part(settings: _TrackSettings) -> SoundTrack:
    """Digital silence, or noise far below the level of the track."""
    rng = settings.rng
    samples = round(float(rng.uniform(1, 6)) * SAMPLE_RATE_HZ)
    audio: FloatArray = np.zeros(samples, np.float32)
    if rng.random() < 0.6:
        loud = 10 ** (min(settings.level_db - rng.uniform(22, 45), -42) / 20)
        fade = np.minimum(1, np.arange(samples) / 1200)
        audio = (loud * background(rng, samples) * fade * fade[::-1]).astype(np.float32)
    audio = whole_frames(audio)
    return SoundTrack(audio, spans=(Span(0.0, len(audio) / SAMPLE_RATE_HZ, "silence"),))


def _finish(track: SoundTrack, rng: np.random.Generator) -> SoundTrack:
    """Add quiet noise to some tracks, and limit the peaks."""
    if rng.random() < 0.35 and any(span.kind != "silence" for span in track.spans):
        track = replace(track, audio=add_background(track.audio, rng, float(rng.uniform(24, 45))))
    return replace(track, audio=np.clip(track.audio, -0.98, 0.98).astype(np.float32))
