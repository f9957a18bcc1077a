"""What a voice feels: happy, angry or sad, heard in how it differs from the same voice before.

Not in the paper. Joy raises the pitch and widens its range, anger makes a voice harsh and bright, sadness dulls it and
quiets its changes (Juslin and Laukka 2003). Statistics of the last seconds of speech, less the speaker's own mean of
them, go through one linear layer, fitted to acted speech (`scripts/make_feeling.py`). None depends on the loudness. A
feeling shows as far as it is likelier than every other, so a voice that may be happy or angry shows neither. A frame
depends on the sound up to its end alone, whatever the chunks, so a session that goes back gives the same again.
"""

import math
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from .motion_chunk import KEPT

FEELINGS = ("happy", "angry", "sad")
LAYER = {  # statistic: mean of many voices, deviation, weights for neutral, happy, angry, sad
    "pitch": (87.9, 4.2, -0.354, 0.771, 1.03, -1.45),  # semitones over 1 Hz
    "range": (2.27, 0.924, -0.169, 0.528, 0.121, -0.48),  # semitones off its mean
    "slope": (0.403, 0.0943, 0.111, 0.18, 0.155, -0.446),  # semitones a hop
    "clarity": (0.852, 0.0324, 0.121, 0.256, -0.552, 0.175),  # correlation with the sound a period before
    "flux": (4.91, 0.634, 0.151, 0.462, 0.0525, -0.666),  # dB a hop, of the bands
    "brightness": (-14.4, 4.11, -0.542, 0.0334, 0.168, 0.34),  # dB, middle bands over low ones
}
BIAS = (1.29, -0.203, -0.591, -0.497)
_MEAN, _DEVIATION, *_ROWS = np.array(list(LAYER.values())).T.copy()
_WEIGHTS = np.array(_ROWS)  # (4, 6)

MEMORY_S = 3.0  # of speech, in which its statistics fade to a third
SILENT_S = 0.4  # of silence, in which they fade as much: a new phrase is heard afresh
SURE_S = 1.5  # of speech before a feeling is fully shown
MANY_VOICES_S = 1.0  # the mean of many voices counts like so much speech of the speaker
MOST_KNOWN_S = 40.0  # so much of the last speech makes the speaker's own mean
LEAST, FULL = 0.2, 0.6  # by how much a feeling must be likelier than the next to show at all, and fully
RISE_S, FALL_S = 0.6, 1.2  # until a feeling is fully shown, and gone
QUIET_DB, FAINTEST_DB = 25.0, -60.0  # a pause: so far under the loudest of the last seconds; below this level
_FORGETS_DB = 0.05  # per hop: the loudest of the last seconds fades
FARTHEST = 3.0  # deviations from the speaker's mean; more is no surer

_HOP, _WINDOW, _FFT = SAMPLES_PER_FRAME // 2, 1600, 2048  # samples; the window holds four periods of a low voice
_RATE = 2 * FRAME_RATE_HZ  # hops a second
_VOICED, _CLEAR = 0.55, 0.65  # least correlation with the sound a period before: of voiced hops; of a clear pitch
LEAST_HOPS = 12  # with a clear pitch, before the statistics mean something
_OUTLIER, _LEAP = 9.0, 2.0  # semitones off the mean, and from hop to hop, from which on a pitch is an octave error
_SHORTER, _NEARER = 0.0025, 0.01  # correlation that a semitone higher, and one nearer to the mean pitch, is worth
_FIRST, _LAST = SAMPLE_RATE_HZ // 450, SAMPLE_RATE_HZ // 65  # samples of a period
_SEMITONES = 12 * np.log2(SAMPLE_RATE_HZ / np.arange(_FIRST, _LAST))
_HANN = np.hanning(_WINDOW)
_TAPER = np.correlate(_HANN, _HANN, "full")[_WINDOW - 1 :][:_LAST]  # how the window itself fades with the lag
_EDGES_HZ = 700 * (np.geomspace(1 + 80 / 700, 1 + 7500 / 700, 27) - 1)  # recordings at 16 kHz reach as far
_EDGES = np.round(_EDGES_HZ * _FFT / SAMPLE_RATE_HZ).astype(int)
_LOW, _MIDDLE = (2, 8), (10, 16)  # 235 to 909 Hz; 1.2 to 2.6 kHz


class Memory(NamedTuple):
    """What one voice's statistics remember after a chunk."""

    sound: Float[np.ndarray, " s"] = np.zeros(_WINDOW - _HOP)  # the last samples
    bands: Float[np.ndarray, " b"] = np.zeros(len(_EDGES) - 1)  # dB, of the last hop
    sums: Float[np.ndarray, " 11"] = np.zeros(11)  # fading, see `_follow`
    loudest: float = FAINTEST_DB + QUIET_DB  # dB, of the last seconds
    pitch: float = 0.0  # semitones, of the hop before; 0: it was not voiced
    usual: Float[np.ndarray, " 6"] = _MEAN  # the speaker's mean statistics
    known_s: float = MANY_VOICES_S  # seconds of speech in `usual`
    shown: Float[np.ndarray, " 3"] = np.zeros(len(FEELINGS))  # in the last frame


class Feeling:
    """The feeling in one session's voice."""

    def __init__(self, before: "Memory | None" = None) -> None:
        """`before` is what was heard before the first chunk."""
        self.memories = {-1: before or Memory()}

    def hear(self, chunk: int, speech: Float[np.ndarray, " s"]) -> Float[np.ndarray, "t 3"]:
        """How far each of `FEELINGS` shows in the frames of a chunk, 0 to 1; `speech` is its sound, 24 kHz."""
        before = self.memories.get(chunk - 1) or Memory()
        frames = len(speech) // SAMPLES_PER_FRAME
        sound = np.concatenate([before.sound, speech]).astype(np.float64)
        windows = np.lib.stride_tricks.sliding_window_view(sound, _WINDOW)[::_HOP][: 2 * frames]
        levels = 10 * np.log10(np.square(windows[:, -_HOP:]).mean(1) + 1e-12)
        peaks = list(accumulate(levels.tolist(), loudest, initial=before.loudest))[1:]
        is_loud, shown = levels >= np.array(peaks) - QUIET_DB, np.zeros((frames, len(FEELINGS)))
        bands, sums, usual = (part.copy() for part in (before.bands, before.sums, before.usual))
        rest = np.array([before.pitch, before.known_s, *before.shown])
        power = np.square(np.abs(np.fft.rfft(windows[is_loud] * _HANN, _FFT)))
        same = np.fft.irfft(power)[:, :_LAST] / _TAPER  # the correlation with the sound so many samples before
        fits = np.ascontiguousarray(same[:, _FIRST:] / np.maximum(same[:, :1], 1e-12))
        floor = 10 ** (np.array(peaks)[is_loud, None] / 10 - 7) * _TAPER[0]
        found = 10 * np.log10(np.add.reduceat(power, _EDGES, axis=1)[:, :-1] / np.diff(_EDGES) + floor)
        _follow(is_loud, found, fits, bands, sums, usual, rest, shown)
        pitch, known_s = rest[:2].tolist()
        self.memories[chunk] = Memory(
            sound[len(speech) :], bands, sums, peaks[-1] if peaks else before.loudest, pitch, usual, known_s, rest[2:]
        )
        self.memories.pop(chunk - KEPT, None)
        return shown


def warm_up() -> None:
    """Compile the loop; the result is cached on disk."""
    Feeling().hear(0, np.zeros(SAMPLES_PER_FRAME, np.float32))


def loudest(before: float, level: float, forgets: float = _FORGETS_DB) -> float:
    """The loudest of the last seconds, dB, with one more stretch of this level; it fades by `forgets`."""
    return max(before - forgets, level, FAINTEST_DB + QUIET_DB)


@kernel()
def _pitch(fits, center):  # type: ignore[no-untyped-def]
    """The place of the best period among the correlations with the sound a period before.

    Of the periods that fit, a short one is taken, and one near the voice's mean pitch; 0 where that is unknown.
    """
    best, most = 0, -np.inf
    for at in range(len(fits)):
        is_peak = 0 < at < len(fits) - 1 and fits[at] >= fits[at - 1] and fits[at] >= fits[at + 1]
        appeal = (fits[at] if is_peak else -1.0) + _SHORTER * _SEMITONES[at]
        if center > 0:
            appeal -= _NEARER * abs(_SEMITONES[at] - center)
        if appeal > most:
            best, most = at, appeal
    return best


@kernel()
def statistics(sums):  # type: ignore[no-untyped-def]
    """What the layer reads (6), in the order of `LAYER`, from the fading sums (11)."""
    found = np.empty(6)
    found[0], found[1] = sums[6] / max(sums[2], 1e-6), sums[7] / max(sums[3], 1e-6)
    found[2], found[3] = sums[8] / max(sums[4], 1e-6), sums[9] / max(sums[1], 1e-6)
    found[4], found[5] = sums[5] / max(sums[0], 1e-6), sums[10] / max(sums[1], 1e-6)
    return found


@kernel()
def _wanted(sums, usual, goal):  # type: ignore[no-untyped-def]
    """Fill `goal` (3) with how far each feeling is heard, 0 to 1; at most one is above 0."""
    goal[:] = 0.0
    if sums[2] <= LEAST_HOPS:
        return
    found, shares, total = statistics(sums), np.empty(len(BIAS)), 0.0
    for kind in range(len(BIAS)):
        score = BIAS[kind]
        for i in range(len(found)):  # how the last seconds differ from the speaker's mean, in deviations
            score += _WEIGHTS[kind, i] * min(max((found[i] - usual[i]) / _DEVIATION[i], -FARTHEST), FARTHEST)
        shares[kind] = math.exp(score)
        total += shares[kind]
    for kind in range(1, len(BIAS)):
        others = 0.0
        for other in range(len(BIAS)):
            if other != kind:
                others = max(others, shares[other])
        surer = (shares[kind] - others) / total
        share = min(max((surer - LEAST) / (FULL - LEAST), 0.0), 1.0)
        goal[kind - 1] = share * min(1.0, sums[0] / (SURE_S * _RATE))


@kernel()
def _follow(is_loud, bands, fits, before, sums, usual, rest, shown):  # type: ignore[no-untyped-def]
    """Hear the hops of a chunk, two a frame, and fill `shown` (t, 3).

    `bands` (n, b) are the spectra of the loud ones, dB, and `fits` (n, l) their correlations with the sound before.
    The memory is written in place: the bands `before` (b), `sums` (11), `usual` (6), and of the `rest` (5) the pitch,
    `known_s` and the feelings shown.
    """
    goal, loud = np.empty(shown.shape[1]), -1
    for hop in range(len(is_loud)):
        fade = math.exp(-1 / ((MEMORY_S if is_loud[hop] else SILENT_S) * _RATE))
        center = sums[6] / sums[2] if sums[2] > 1 else 0.0
        for i in range(len(sums)):
            sums[i] *= fade
        if is_loud[hop]:
            loud += 1
            place = _pitch(fits[loud], center)
            clarity, pitch = fits[loud, place], _SEMITONES[place]
            voiced, clear = clarity > _VOICED, clarity > _CLEAR
            off, leap = abs(pitch - center), abs(pitch - rest[0])
            flux = low = middle = 0.0
            for i in range(len(before)):
                flux += min(abs(bands[loud, i] - before[i]), 20.0) / len(before)
                before[i] = bands[loud, i]
            for i in range(_LOW[0], _LOW[1]):
                low += bands[loud, i] / (_LOW[1] - _LOW[0])
            for i in range(_MIDDLE[0], _MIDDLE[1]):
                middle += bands[loud, i] / (_MIDDLE[1] - _MIDDLE[0])
            sums[0] += 1.0
            sums[5] += flux
            if voiced:
                sums[1] += 1.0
                sums[9] += clarity
                sums[10] += middle - low
            if clear:
                sums[2] += 1.0
                sums[6] += pitch
            if clear and center > 0 and off < _OUTLIER:
                sums[3] += 1.0
                sums[7] += off
            if voiced and rest[0] > 0 and leap < _LEAP:
                sums[4] += 1.0
                sums[8] += leap
            if sums[2] > LEAST_HOPS:
                rest[1] = min(rest[1] + 1 / _RATE, MOST_KNOWN_S)
                found = statistics(sums)
                for i in range(len(usual)):
                    usual[i] += (found[i] - usual[i]) / (rest[1] * _RATE)
            rest[0] = pitch if voiced else 0.0
        else:
            rest[0] = 0.0
        if hop % 2:
            _wanted(sums, usual, goal)
            for i in range(len(goal)):  # feelings come and go slowly
                step = goal[i] - rest[2 + i]
                rest[2 + i] += min(max(step, -1 / (FALL_S * FRAME_RATE_HZ)), 1 / (RISE_S * FRAME_RATE_HZ))
                shown[hop // 2, i] = rest[2 + i]
