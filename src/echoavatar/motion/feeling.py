"""What a voice feels: happy, angry or sad, heard in how it differs from how the same voice spoke before.

Not in the paper. Joy raises the pitch and widens its range, anger makes a voice harsh and bright, sadness dulls it and
quiets its changes (Juslin and Laukka 2003). Statistics of the last seconds of speech, less the speaker's own mean of
them, go through one linear layer, fitted to acted speech (`scripts/make_feeling.py`). None depends on the loudness. A
feeling shows as far as it is surer than every other, so a voice that may be happy or angry shows neither. A frame
depends on the sound up to its end alone, whatever the chunks, and a session that goes back hears the same again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
_MEAN, _DEVIATION, *_WEIGHTS = np.array(list(LAYER.values())).T

MEMORY_S = 3.0  # of speech, in which its statistics fade to a third
SILENT_S = 0.4  # of silence, in which they do: a new phrase is heard afresh
SURE_S = 1.5  # of speech before a feeling is fully shown
MANY_VOICES_S = 1.0  # of the speaker's own speech, as which the mean of many voices counts
MOST_KNOWN_S = 40.0  # of speech, that the mean of the speaker goes back
LEAST, FULL = 0.2, 0.6  # how much surer than the next one: shown a little, and fully
RISE_S, FALL_S = 0.6, 1.2  # until a feeling is fully shown, and gone
QUIET_DB, FAINTEST_DB = 25.0, -60.0  # under the loudest of the last seconds, and at all: a pause
_FORGETS_DB = 0.05  # per hop: the loudest of the last seconds fades
FARTHEST = 3.0  # deviations from the speaker's mean; more is no surer

_HOP, _WINDOW, _FFT = SAMPLES_PER_FRAME // 2, 1600, 2048  # samples; the window holds four periods of a low voice
_RATE = 2 * FRAME_RATE_HZ  # hops a second
_VOICED, _CLEAR = 0.55, 0.65  # of the correlation with the sound a period before: voiced; its pitch is believed
LEAST_HOPS = 12  # with a clear pitch, before the statistics mean something
_OUTLIER, _LEAP = 9.0, 2.0  # semitones off the mean, and from hop to hop: an octave error
_SHORTER, _NEARER = 0.0025, 0.01  # of correlation that a semitone higher, and nearer to the mean pitch, is worth
_FIRST, _LAST = SAMPLE_RATE_HZ // 450, SAMPLE_RATE_HZ // 65  # samples of a period
_SEMITONES = 12 * np.log2(SAMPLE_RATE_HZ / np.arange(_FIRST, _LAST))
_HANN = np.hanning(_WINDOW)
_TAPER = np.correlate(_HANN, _HANN, "full")[_WINDOW - 1 :][:_LAST]  # how the window itself fades with the lag
_EDGES_HZ = 700 * (np.geomspace(1 + 80 / 700, 1 + 7500 / 700, 27) - 1)  # recordings at 16 kHz have as much
_EDGES = np.round(_EDGES_HZ * _FFT / SAMPLE_RATE_HZ).astype(int)
_LOW, _MIDDLE = slice(2, 8), slice(10, 16)  # 235 to 909 Hz; 1.2 to 2.6 kHz


class Memory(NamedTuple):
    """After a chunk."""

    sound: Float[np.ndarray, " s"] = np.zeros(_WINDOW - _HOP)  # the last samples
    bands: Float[np.ndarray, " b"] = np.zeros(len(_EDGES) - 1)  # dB, of the last hop
    sums: Float[np.ndarray, " 11"] = np.zeros(11)  # fading, see `_heard`
    loudest: float = FAINTEST_DB + QUIET_DB  # dB, of the last seconds
    pitch: float = 0.0  # semitones, of the hop before; 0: it was not voiced
    usual: Float[np.ndarray, " 6"] = _MEAN  # the speaker's mean statistics
    known_s: float = MANY_VOICES_S  # of speech behind it
    shown: Float[np.ndarray, " 3"] = np.zeros(len(FEELINGS))


class Feeling:
    """The feeling in one session's voice."""

    def __init__(self, before: "Memory | None" = None) -> None:
        """`before` is what was heard before the first chunk."""
        self.memories = {-1: before or Memory()}

    def hear(self, chunk: int, speech: Float[np.ndarray, " s"]) -> Float[np.ndarray, "t 3"]:
        """How far each of `FEELINGS` shows in the frames of a chunk, 0 to 1; `speech` is its sound, 24 kHz."""
        before = self.memories.get(chunk - 1) or Memory()
        sound = np.concatenate([before.sound, speech]).astype(np.float64)
        now, path = before._replace(sound=sound[len(speech) :]), []
        for frame in range(len(speech) // SAMPLES_PER_FRAME):
            for end in _WINDOW + frame * SAMPLES_PER_FRAME + np.array([0, _HOP]):
                now = _heard(now, sound[end - _HOP : end], sound[end - _WINDOW : end])
            now = now._replace(shown=_towards(now.shown, wanted(now.sums, now.usual)))
            path.append(now.shown)
        self.memories[chunk] = now
        self.memories.pop(chunk - KEPT, None)
        return np.array(path)


def _heard(memory: Memory, hop: Float[np.ndarray, " s"], window: Float[np.ndarray, " w"]) -> Memory:
    """The memory with one more hop of sound, the last of a window."""
    level = float(10 * np.log10(np.mean(np.square(hop)) + 1e-12))
    loudest = max(memory.loudest - _FORGETS_DB, level, FAINTEST_DB + QUIET_DB)
    if level < loudest - QUIET_DB:
        faded = memory.sums * np.exp(-1 / (SILENT_S * _RATE))
        return memory._replace(sums=faded, loudest=loudest, pitch=0.0)
    power = np.square(np.abs(np.fft.rfft(window * _HANN, _FFT)))
    floor = 10 ** (loudest / 10 - 7) * _TAPER[0]
    bands = 10 * np.log10(np.add.reduceat(power, _EDGES)[:-1] / np.diff(_EDGES) + floor)
    center = memory.sums[6] / memory.sums[2] if memory.sums[2] > 1 else 0.0
    clarity, pitch = _pitch(power, center)
    voiced, clear = clarity > _VOICED, clarity > _CLEAR
    off, leap = abs(pitch - center), abs(pitch - memory.pitch)
    inlying, smooth = clear and center > 0 and off < _OUTLIER, voiced and memory.pitch > 0 and leap < _LEAP
    flux = np.minimum(np.abs(bands - memory.bands), 20).mean()
    brightness = bands[_MIDDLE].mean() - bands[_LOW].mean()
    counts = (1, voiced, clear, inlying, smooth)
    added = (flux, clear * pitch, inlying * off, smooth * leap, voiced * clarity, voiced * brightness)
    sums = memory.sums * np.exp(-1 / (MEMORY_S * _RATE)) + np.array([*counts, *added])
    usual, known = memory.usual, memory.known_s
    if sums[2] > LEAST_HOPS:
        known = min(known + 1 / _RATE, MOST_KNOWN_S)
        usual = usual + (statistics(sums) - usual) / (known * _RATE)
    return memory._replace(
        bands=bands, sums=sums, loudest=loudest, pitch=pitch if voiced else 0.0, usual=usual, known_s=known
    )


def _pitch(power: Float[np.ndarray, " f"], center: float) -> tuple[float, float]:
    """The correlation with the sound a period before, and the pitch of that period, semitones over 1 Hz.

    Of the periods that fit, a short one is taken, and one near the voice's mean pitch; 0 where that is unknown.
    """
    same = np.fft.irfft(power)[:_LAST] / _TAPER
    fits = (same / max(same[0], 1e-12))[_FIRST:]
    is_peak = np.zeros(len(fits), bool)
    is_peak[1:-1] = (fits[1:-1] >= fits[:-2]) & (fits[1:-1] >= fits[2:])
    appeal = np.where(is_peak, fits, -1) + _SHORTER * _SEMITONES
    at = int(np.argmax(appeal - _NEARER * np.abs(_SEMITONES - center) * (center > 0)))
    return float(fits[at]), float(_SEMITONES[at])


def statistics(sums: Float[np.ndarray, " 11"]) -> Float[np.ndarray, " 6"]:
    """What the layer reads, in the order of `LAYER`."""
    speech, voiced, clear, inlying, smooth = np.maximum(sums[:5], 1e-6)
    flux, pitch, off, leap, clarity, brightness = sums[5:]
    return np.array([pitch / clear, off / inlying, leap / smooth, clarity / voiced, flux / speech, brightness / voiced])


def difference(sums: Float[np.ndarray, " 11"], usual: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
    """How the last seconds differ from the speaker's mean, in deviations."""
    found: Float[np.ndarray, " 6"] = np.clip((statistics(sums) - usual) / _DEVIATION, -FARTHEST, FARTHEST)
    return found


def wanted(sums: Float[np.ndarray, " 11"], usual: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 3"]:
    """How far each feeling is heard, 0 to 1; at most one is above 0."""
    if sums[2] <= LEAST_HOPS:
        return np.zeros(len(FEELINGS))
    scores = np.exp(np.array(BIAS) + np.array(_WEIGHTS) @ difference(sums, usual))
    shares = scores / scores.sum()
    surer = np.array([share - np.delete(shares, at).max() for at, share in enumerate(shares)])[1:]
    shown: Float[np.ndarray, " 3"] = np.clip((surer - LEAST) / (FULL - LEAST), 0, 1)
    return shown * min(1.0, float(sums[0]) / (SURE_S * _RATE))


def _towards(old: Float[np.ndarray, " 3"], goal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """A frame later, as far towards the goal as feelings come and go."""
    step = np.clip(goal - old, -1 / (FALL_S * FRAME_RATE_HZ), 1 / (RISE_S * FRAME_RATE_HZ))
    now: Float[np.ndarray, " 3"] = old + step
    return now
