"""What a voice feels: happy, angry or sad, heard in its pitch, its energy, its pace and its timbre. Not in the paper.

Statistics of the last seconds of the avatar's speech go through one linear layer, whose numbers in `feeling.json` were
fitted to acted speech and plain reading (`scripts/make_feeling.py`). They do not depend on the loudness. A feeling is
shown as far as it is surer than every other; so a voice that may be happy or angry shows neither. It depends on the
sound up to now alone, and a session that goes back decides the same again.
"""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.motion.expression import FEELINGS
from echoavatar.motion.motion_chunk import KEPT
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

MEMORY_S = 2.5  # of speech, in which its statistics fade to a third
SURE_S = 1.0  # of speech before a feeling is fully shown
# How much surer than the next one each is from which it is shown, and fully: joy that looks angry is the worst mistake.
LEAST, FULL = np.array([0.15, 0.35, 0.15]), np.array([0.6, 0.9, 0.6])
RISE_S, FALL_S = 0.6, 1.2  # until a feeling is fully shown, and gone
SILENT_S = 1.5  # of silence, in which what was heard fades to a third
QUIET_DB = 30.0  # under the loudest of the last seconds, sound is a pause
FAINTEST_DB = -60.0
_FORGETS_DB = 0.1  # per frame: the loudest of the last seconds fades
_WINDOW, _FFT = 1600, 2048  # samples; 67 ms hold three periods of a low voice
_BANDS, _LOW_HZ, _HIGH_HZ = 20, 100.0, 7000.0  # recordings at 16 kHz have as much
_TIMBRES = 8  # cosines of the log spectrum; the first is its mean
_PITCHES_HZ = (70.0, 450.0)
_VOICED = 0.5  # of the correlation with the sound a period before
STATISTICS = 2 * _TIMBRES + 6


class _Memory(NamedTuple):
    """After a chunk."""

    sound: Float[np.ndarray, " s"]  # the last samples
    sums: Float[np.ndarray, " n"]  # fading sums over frames of speech, see `_heard`
    loudest: float  # dB
    was_voiced: bool
    pitch: float  # octaves over 1 Hz, of the last voiced frame
    shown: Float[np.ndarray, " f"]  # how far each feeling is shown


class Feeling:
    """The feeling in one session's voice."""

    def __init__(self) -> None:
        nothing = np.zeros(_WINDOW), np.zeros(_SUMS), FAINTEST_DB, False, 0.0, np.zeros(len(FEELINGS))
        self._nothing = _Memory(*nothing)
        self._memories: dict[int, _Memory] = {}

    def hear(self, chunk: int, speech: Float[np.ndarray, " s"]) -> Float[np.ndarray, "t f"]:
        """How far each of `FEELINGS` is shown in the frames of a chunk, 0 to 1; `speech` is its sound, 24 kHz."""
        before = self._memories.get(chunk - 1, self._nothing)
        now = _heard(before, speech)
        path = _approach(before.shown, wanted(now.sums), len(speech) // SAMPLES_PER_FRAME)
        self._memories[chunk] = now._replace(shown=path[-1])
        self._memories.pop(chunk - KEPT, None)
        return path


def statistics(sums: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
    """What the layer reads: means and deviations of timbre, energy and pitch, the share of voice, and its pace."""
    frames, voiced = max(sums[0], 1e-6), max(sums[1], 1e-6)
    mean, square = sums[5 : 5 + _TIMBRES + 1] / frames, sums[5 + _TIMBRES + 1 : _SUMS - 2] / frames
    deviation = np.sqrt(np.maximum(square - mean**2, 0))
    pitch = sums[-2] / voiced
    pitches = np.sqrt(max(sums[-1] / voiced - pitch**2, 0.0))
    rest = [pitch, pitches, sums[3] / voiced, sums[1] / frames, sums[2] / frames, sums[4] / frames]
    return np.concatenate([mean[1:_TIMBRES], deviation[: _TIMBRES + 1], rest])


def wanted(sums: Float[np.ndarray, " n"]) -> Float[np.ndarray, " f"]:
    """How far each feeling is heard, 0 to 1; at most one is above 0. The layer's first output is for none of them."""
    layer = _layer()
    scores = layer["weights"] @ ((statistics(sums) - layer["mean"]) / layer["deviation"]) + layer["bias"]
    shares = np.exp(scores - scores.max())
    shares /= shares.sum()
    surer = [share - np.delete(shares, at).max() for at, share in enumerate(shares)][1:]
    is_sure = min(1.0, float(sums[0]) / (SURE_S * FRAME_RATE_HZ))
    return np.asarray(np.clip((np.array(surer) - LEAST) / (FULL - LEAST), 0, 1) * is_sure)


def _heard(memory: _Memory, speech: Float[np.ndarray, " s"]) -> _Memory:
    """The memory with the frames of a chunk."""
    sound = np.concatenate([memory.sound, speech]).astype(np.float64)
    sums, loudest, was_voiced, last = memory.sums.copy(), memory.loudest, memory.was_voiced, memory.pitch
    for end in range(_WINDOW + SAMPLES_PER_FRAME, len(sound) + 1, SAMPLES_PER_FRAME):
        window = sound[end - _WINDOW : end] * _HANN
        level = 10 * np.log10(np.mean(sound[end - SAMPLES_PER_FRAME : end] ** 2) + 1e-12)
        loudest = max(loudest - _FORGETS_DB, level, FAINTEST_DB + QUIET_DB / 2)
        if level < max(loudest - QUIET_DB, FAINTEST_DB):
            sums *= np.exp(-1 / (SILENT_S * FRAME_RATE_HZ))
            was_voiced = False
            continue
        power = np.abs(np.fft.rfft(window, 2 * _FFT)) ** 2
        log = np.log10(power @ _filters() + 10 ** (loudest / 10 - 6) * _FFT)
        values = np.append(_COSINES @ log, level / 10)
        correlation, pitch = _pitch(power)
        is_voiced = correlation > _VOICED
        slope = abs(pitch - last) if is_voiced and was_voiced else 0.0
        starts = is_voiced and not was_voiced
        voice = (pitch, pitch**2) if is_voiced else (0.0, 0.0)
        sums *= np.exp(-1 / (MEMORY_S * FRAME_RATE_HZ))
        sums += np.concatenate([[1, is_voiced, starts, slope, correlation], values, values**2, voice])
        was_voiced, last = is_voiced, pitch if is_voiced else last
    return _Memory(sound[-_WINDOW:], sums, loudest, was_voiced, last, memory.shown)


def _pitch(power: Float[np.ndarray, " b"]) -> tuple[float, float]:
    """The correlation with the sound a period before, and the pitch of that period, octaves over 1 Hz."""
    same = np.fft.irfft(power)[: len(_SLOPE)] / _SLOPE
    same /= max(same[0], 1e-12)
    first = int(SAMPLE_RATE_HZ / _PITCHES_HZ[1])
    places = same[first:]
    is_peak = (places[1:-1] >= places[:-2]) & (places[1:-1] >= places[2:])
    peaks = np.flatnonzero(is_peak & (places[1:-1] > 0.9 * places.max())) + 1
    at = int(peaks[0]) if len(peaks) else int(places.argmax())
    return float(places[at]), float(np.log2(SAMPLE_RATE_HZ / (first + at)))


def _approach(old: Float[np.ndarray, " f"], goal: Float[np.ndarray, " f"], frames: int) -> Float[np.ndarray, "t f"]:
    """From one value towards another, frame by frame, at most as fast as feelings come and go."""
    rise, fall = 1 / (RISE_S * FRAME_RATE_HZ), 1 / (FALL_S * FRAME_RATE_HZ)
    return np.array([old + np.clip(goal - old, -fall * step, rise * step) for step in range(1, frames + 1)])


_HANN = np.hanning(_WINDOW)
_SLOPE = np.correlate(_HANN, _HANN, "full")[_WINDOW - 1 :][: int(SAMPLE_RATE_HZ / _PITCHES_HZ[0])]
_SLOPE = _SLOPE / _SLOPE[0]  # how the window itself fades with the lag
_COSINES = np.cos(np.pi * np.outer(np.arange(_TIMBRES), np.arange(_BANDS) + 0.5) / _BANDS) / _BANDS
_SUMS = (
    5 + 2 * (_TIMBRES + 1) + 2
)  # frames, voiced ones, starts, slope, correlation; values; squares; pitch, its square


@cache
def _filters() -> Float[np.ndarray, "b m"]:
    """Triangles, equal steps on the mel scale, each of sum 1."""
    edges = 700 * (np.geomspace(1 + _LOW_HZ / 700, 1 + _HIGH_HZ / 700, _BANDS + 2) - 1)
    bins = np.fft.rfftfreq(2 * _FFT, 1 / SAMPLE_RATE_HZ)[:, None]
    rise, fall = (bins - edges[:-2]) / np.diff(edges)[:-1], (edges[2:] - bins) / np.diff(edges)[1:]
    filters = np.clip(np.minimum(rise, fall), 0, None)
    return np.asarray(filters / filters.sum(0))


@cache
def _layer() -> dict[str, Float[np.ndarray, "..."]]:
    """The fitted numbers: `mean` and `deviation` (k) of the statistics, `weights` (1 + f, k) and `bias` (1 + f)."""
    layer = json.loads(files(__package__).joinpath("feeling.json").read_text())
    return {name: np.array(layer[name]) for name in ("mean", "deviation", "weights", "bias")}
