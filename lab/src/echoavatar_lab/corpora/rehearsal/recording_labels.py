"""Recordings as sound tracks: estimates the labels that synthetic sound has by construction.

Not in the paper. Recordings among the synthetic sound keep a model from learning only the synthesiser.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

from echoavatar.errors import AudioError
from echoavatar.timing import SAMPLE_RATE_HZ

from ..controls import spans_of
from ..music.beat_tracker import track_beats
from ..sound import FloatArray, Section, SoundTrack, Span, Syllable, TimeArray, bridged, merge_spans, whole_frames
from .augment import set_loudness

_HOP = 240  # 10 ms
_FRAME_S = _HOP / SAMPLE_RATE_HZ
_LOUDNESS_DB = -23.08253637749964  # corpora were made with this value; the labels hardly depend on it
_SPEECH_FLOOR_DB = -27.0  # below loud speech; breath lies lower, ends of words higher
Array = np.ndarray


def track_from_recording(audio: FloatArray, kind: str, loop_s: float = 0.0) -> SoundTrack:
    """Label a recording (s,) of 24 kHz mono "speech" or "music", and set its loudness to -23 dB.

    With `loop_s` it is a musical loop of that length, played several times (`track_beats`). Raises AudioError: another
    kind, or less than a second of finite mono samples.
    """
    if kind not in ("speech", "music"):
        raise AudioError(f"a recording's kind is {kind!r}; pass 'speech' or 'music'")
    if audio.ndim != 1 or len(audio) < SAMPLE_RATE_HZ or not np.isfinite(audio).all():
        raise AudioError(f"recording of shape {audio.shape}; pass at least one second of finite mono samples")
    audio = whole_frames(set_loudness(audio.astype(np.float32), _LOUDNESS_DB))
    return _label_speech(audio) if kind == "speech" else _label_music(audio, loop_s)


def _label_music(audio: FloatArray, loop_s: float) -> SoundTrack:
    found = track_beats(audio, loop_s=loop_s)
    end = len(audio) / SAMPLE_RATE_HZ
    power = _frame_power(audio)
    loud = _active(power, floor_db=-42, bridge_s=1.5, shortest_s=2.0)
    spans = _as_spans(loud, "music", end)
    return SoundTrack(
        audio=audio,
        spans=spans,
        beats=_heard(found.beats, loud),
        downbeats=_heard(found.downbeats, loud),
        sections=_sections(power, loud),
        style="recording",
        bpm=found.bpm,
    )


def _heard(beats: TimeArray, loud: list[tuple[float, float]]) -> TimeArray:
    """The beats within loud stretches."""
    return np.array([beat for beat in beats if any(a - 0.05 <= beat <= b for a, b in loud)], np.float64)


def _frame_power(audio: FloatArray) -> Array:
    """Mean square per 10 ms (t,)."""
    count = len(audio) // _HOP
    return np.asarray(np.mean(audio[: count * _HOP].reshape(count, _HOP).astype(np.float64) ** 2, axis=1)) + 1e-12


def _active(power: Array, *, floor_db: float, bridge_s: float, shortest_s: float) -> list[tuple[float, float]]:
    """Stretches louder than `floor_db` relative to the loud parts; gaps shorter than `bridge_s` are bridged."""
    smooth = np.convolve(power, np.ones(5) / 5, mode="same")
    level = 10 * np.log10(smooth)
    top, bottom = np.quantile(level, [0.95, 0.05])
    on = level > max(top + floor_db, min(bottom + 6, top - 20))
    stretches = bridged((np.array(spans_of(on)) * _FRAME_S).tolist(), bridge_s)
    return [(a, b) for a, b in stretches if b - a >= shortest_s]


def _as_spans(active: list[tuple[float, float]], kind: str, end: float) -> tuple[Span, ...]:
    """Spans from 0 to `end`: active stretches are `kind`, gaps of 0.7 s and more are silence."""
    spans: list[Span] = []
    now = 0.0
    for a, b in active:
        spans.append(Span(now, a, "silence" if a - now >= 0.7 else kind))
        spans.append(Span(a, b, kind))
        now = b
    spans.append(Span(now, end, "silence" if end - now >= 0.7 or not active else kind))
    return merge_spans(spans)


def _sections(power: Array, loud: list[tuple[float, float]]) -> tuple[Section, ...]:
    """Stretches of about 4 s, merged while loudness stays within 2.5 dB; energy 0.15..1 follows loudness."""
    sections: list[Section] = []
    top = 10 * np.log10(np.quantile(power, 0.95))
    for a, b in loud:
        edges = np.linspace(a, b, max(1, round((b - a) / 4)) + 1)
        for first, last in zip(edges, edges[1:], strict=False):
            part = power[round(first / _FRAME_S) : max(round(first / _FRAME_S) + 1, round(last / _FRAME_S))]
            energy = float(np.clip(1 + (10 * np.log10(np.mean(part)) - top + 4) / 24, 0.15, 1))
            if sections and sections[-1].end == first and abs(sections[-1].energy - energy) < 2.5 / 24:
                sections[-1] = replace(sections[-1], end=float(last))
            else:
                sections.append(Section(float(first), float(last), energy))
    return tuple(sections)


def _label_speech(audio: FloatArray) -> SoundTrack:
    power = _frame_power(_band(audio, 300, 3000))
    voice = _frame_power(_band(audio, 120, 6000))  # without steps, breath on the microphone and hiss
    level = 10 * np.log10(np.convolve(power, np.hanning(9)[1:-1] / np.hanning(9)[1:-1].sum(), mode="same"))
    stretches = _active(voice, floor_db=_SPEECH_FLOOR_DB, bridge_s=0.2, shortest_s=0.15)
    spoken = [(stretch, _nuclei(audio, level, *stretch)) for stretch in stretches]
    spoken = [(stretch, syllables) for stretch, syllables in spoken if syllables]
    phrases = [stretch for stretch, _ in spoken]
    every = tuple(syllable for _, syllables in spoken for syllable in syllables)
    end = len(audio) / SAMPLE_RATE_HZ
    return SoundTrack(audio, _as_spans(phrases, "speech", end), every, tuple(phrases))


def _band(audio: FloatArray, low_hz: float, high_hz: float) -> FloatArray:
    filtered = sosfiltfilt(butter(2, (low_hz, high_hz), "bandpass", fs=SAMPLE_RATE_HZ, output="sos"), audio)
    return np.asarray(filtered, np.float32)


def _nuclei(audio: FloatArray, level: Array, begin: float, end: float) -> list[Syllable]:
    """Syllables of one phrase: energy peaks and the minima between them; a breath or a click has none."""
    first, last = round(begin / _FRAME_S), min(len(level), round(end / _FRAME_S))
    part = level[first:last]
    if len(part) < 5:
        return []
    peaks = find_peaks(np.pad(part, 1, constant_values=part.min() - 20), distance=9, prominence=2.5)[0] - 1
    peaks = peaks[part[peaks] > part.max() - 22]
    if not len(peaks):
        return []
    valleys = [first + a + int(np.argmin(part[a : b + 1])) for a, b in zip(peaks, peaks[1:], strict=False)]
    edges = [first, *valleys, last]
    pitch = np.array([_pitch(audio, int(first + p) * _HOP) for p in peaks])
    if not pitch.any():
        return []
    scores = _salience(part[peaks], pitch, np.diff(edges) * _FRAME_S)
    nuclear = _nuclear(scores, (first + peaks) * _FRAME_S)
    return [
        Syllable(
            start=edges[i] * _FRAME_S,
            end=edges[i + 1] * _FRAME_S,
            vowel=float((first + peak + 0.5) * _FRAME_S),
            prominence=float(0.9 if i in nuclear else 0.75 * scores[i]),
            word="",
            meaning="",
        )
        for i, peak in enumerate(peaks)
    ]


def _salience(level: Array, pitch: Array, seconds: Array) -> Array:
    """Salience 0..1 from loudness, pitch above the phrase's median, and length."""
    loud = np.clip(1 + (level - level.max()) / 14, 0, 1)
    voiced = pitch > 0
    middle = float(np.median(pitch[voiced])) if voiced.any() else 1.0
    high = np.clip(0.4 + 12 * np.log2(np.where(voiced, pitch, middle) / middle) / 8, 0, 1)
    long = np.clip(seconds / 0.35, 0, 1)
    return np.asarray(0.45 * loud + 0.3 * high + 0.25 * long)


def _nuclear(scores: Array, times: Array) -> set[int]:
    """Indices of the most salient syllables: about one every two seconds, at least 1.1 s apart."""
    wanted = max(1, round(float(times[-1] - times[0]) / 2.0))
    chosen: list[int] = []
    for i in np.argsort(-scores).tolist():
        if len(chosen) < wanted and all(abs(times[i] - times[k]) > 1.1 for k in chosen):
            chosen.append(i)
    return set(chosen)


def is_low_voice(audio: FloatArray) -> bool:
    """Whether speech (s,), 24 kHz, of any level has a median pitch below 160 Hz."""
    found = [_pitch(audio, sample) for sample in range(600, len(audio) - 600, 2400)]
    voiced = [pitch for pitch in found if pitch > 0]
    return bool(voiced) and float(np.median(voiced)) < 160


def _pitch(audio: FloatArray, sample: int) -> float:
    """Pitch in Hz near a sample by autocorrelation of 50 ms, 0 if unvoiced (70-400 Hz)."""
    part = audio[max(0, sample - 600) : sample + 600].astype(np.float64)
    if len(part) < 800:
        return 0.0
    part = part - part.mean()
    size = 4096
    correlation = np.fft.irfft(np.abs(np.fft.rfft(part, size)) ** 2)[: len(part)]
    low, high = SAMPLE_RATE_HZ // 400, SAMPLE_RATE_HZ // 70
    normal = correlation / (correlation[0] * (1 - np.arange(len(part)) / len(part)) + 1e-9)
    peak = low + int(np.argmax(normal[low:high]))
    return SAMPLE_RATE_HZ / peak if normal[peak] > 0.4 else 0.0
