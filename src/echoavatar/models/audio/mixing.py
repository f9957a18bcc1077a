"""What a recording needs before it becomes mono, measured over the whole of it, with notes on what was unusual.

An even mix of channels is right for most recordings. It is not where channels cancel each other, or where the speech is
in one of many: then the weights follow from how loud the channels are and how they go together. A constant offset is
taken away; a recording too quiet to be heard, or louder than 1, gets another level.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .files import Form, Piece

_KEPT = 10 ** (-3.2 / 10)  # an even mix with this share of the loudest channel's power is good enough: two voices
_ABOUT = 0.8  # a channel with this share of the loudest one's power is as loud
_SILENT = 1e-4  # of the loudest power: -40 dB
_CANCELLED = 0.2  # channels cancel if the power of their sum is below 0.2 / channels of an in-phase sum's
_MOST_CANCELLED = 0.1  # share of a recording's energy that may cancel in a mix
_OPPOSED = -0.5  # correlation with the loudest channel
_RUMBLE = ("LFE", "LFE2")  # left out
_WEIGHTS = {"FC": 1.0, "FL": 0.7, "FR": 0.7}  # around a centre, where speech is
_OTHER_WEIGHT = 0.5

_QUIET_DB = -45.0  # below it the models' level control takes sound for silence
_FAINTEST_DB = -90.0  # below it there is only the rounding of 16 bits
_LIFTED_DB = -26.0
_STEADY_DB = 8.0  # a recording whose level varies less is noise, and is not lifted
_TONE_DB, _LOUD_SHARE = 3.0, 0.01  # a channel that varies less is no speech; and disturbs from this share of power on
_LOUDEST = 1.25  # peaks of decoded MP3 are a little over 1
_LOUD_PIECES = 3  # fewer pieces above `_LOUDEST` are clicks
_OFFSET = 5e-4
_SHORTEST_S = 0.1  # of sound of one form; shorter stretches are faults in the file
_LEVELS_DB = np.arange(-140.0, 200.0)


class Mix(NamedTuple):
    """How samples of one form become mono."""

    weights: Float[np.ndarray, " c"]
    offset: float  # to take away from their sum

    @np.errstate(invalid="ignore", over="ignore")  # the caller refuses what is not finite
    def __call__(self, samples: Float[np.ndarray, "s c"]) -> Float[np.ndarray, " s"]:
        """Mix down."""
        return np.asarray(samples @ self.weights - self.offset, np.float32)


class Plan(NamedTuple):
    """What to do with a recording."""

    track: int
    mixes: Mapping[Form, Mix]
    notes: Sequence[str]  # what is unusual, each a sentence


class _Sums:
    """Sums over all samples of one form in one track."""

    def __init__(self, form: Form) -> None:
        channels = len(form.channels)
        self.count, self.peak, self.loud = 0, 0.0, 0
        self._sum, self._products = np.zeros(channels), np.zeros((channels, channels))
        self.cancelled = 0.0  # energy where channels go against each other
        self.energies, self.counts = np.zeros(len(_LEVELS_DB)), np.zeros(len(_LEVELS_DB))  # by level
        self.levels = np.zeros((len(_LEVELS_DB), channels))  # samples of each channel, by level

    def add(self, samples: Float[np.ndarray, "s c"]) -> None:
        x = samples.astype(np.float64)
        self.count += len(x)
        peak = float(np.abs(x).max(initial=0))
        self.peak, self.loud = max(self.peak, peak), self.loud + (peak > _LOUDEST)
        total = x.sum(0)
        products = x.T @ x
        self._sum += total
        self._products += products
        here = products - np.outer(total, total) / len(x)
        powers = np.maximum(np.diag(here), 0)
        best = float(powers.max())
        if here.sum() < _CANCELLED / len(powers) * np.sqrt(powers).sum() ** 2:
            self.cancelled += best
        bins = np.clip(10 * np.log10(powers / len(x) + 1e-20) - _LEVELS_DB[0], 0, len(_LEVELS_DB) - 1).astype(int)
        self.levels[bins, np.arange(len(bins))] += len(x)
        self.energies[bins.max()] += best
        self.counts[bins.max()] += len(x)

    @property
    def mean(self) -> Float[np.ndarray, " c"]:
        return self._sum / max(self.count, 1)

    @property
    def covariance(self) -> Float[np.ndarray, "c c"]:
        return self._products / max(self.count, 1) - np.outer(self.mean, self.mean)

    @property
    def power(self) -> float:
        return float(np.diag(self.covariance).max(initial=0))


class Measurement:
    """Measures a recording piece by piece, and then plans what to do with it."""

    def __init__(self) -> None:
        self._sums: dict[tuple[int, Form], _Sums] = {}

    def add(self, piece: Piece) -> None:
        """Measure a piece; one with values that are not finite is passed over, because it will be refused."""
        if len(piece.samples) and np.isfinite(piece.samples).all():
            key = piece.track, piece.form
            self._sums.setdefault(key, _Sums(piece.form)).add(piece.samples)

    def plan(self) -> Plan:
        """The plan for the recording."""
        powers: dict[int, float] = {}
        for (number, _), sums in self._sums.items():
            powers[number] = powers.get(number, 0.0) + sums.power * sums.count
        loudest = max(powers, key=lambda number: (powers[number], -number), default=0)
        track = 0 if powers.get(0, 0.0) >= _SILENT * powers.get(loudest, 0.0) else loudest
        notes = [f"its first track is silent; track {track + 1} is taken"] if track else []
        chosen = {form: sums for (number, form), sums in self._sums.items() if number == track}
        gain = _gain(list(chosen.values()), notes)
        mixes = {form: _mix(form, sums, gain, notes) for form, sums in chosen.items()}
        return Plan(track, mixes, tuple(dict.fromkeys(notes)))


def _gain(all_sums: Sequence[_Sums], notes: list[str]) -> float:
    """The factor that makes a recording audible and keeps it from clipping."""
    peak = max((sums.peak for sums in all_sums), default=0.0)
    energies = sum((sums.energies for sums in all_sums), np.zeros(len(_LEVELS_DB)))
    counts = sum((sums.counts for sums in all_sums), np.zeros(len(_LEVELS_DB)))
    level, quiet = _level_at(energies, 0.5), _level_at(counts, 0.1)
    if sum(sums.loud for sums in all_sums) >= _LOUD_PIECES:
        notes.append(f"its peaks reach {peak:.3g} and are brought down to 1")
        return 1 / peak
    if level < _FAINTEST_DB:
        if all_sums and max(sums.power for sums in all_sums) < 10 ** (_FAINTEST_DB / 10):
            notes.append("it is silent")
    elif level < _QUIET_DB and level - quiet > _STEADY_DB and peak < 1:
        gain = min(10 ** ((_LIFTED_DB - level) / 20), 1 / peak)
        notes.append(f"it is very quiet ({level:.0f} dB) and is made {20 * math.log10(gain):.0f} dB louder")
        return gain
    return 1.0


def _level_at(histogram: Float[np.ndarray, " n"], share: float) -> float:
    """The level below which this share of the histogram lies."""
    at = int(np.searchsorted(histogram.cumsum(), share * histogram.sum()))
    return float(_LEVELS_DB[min(at, len(_LEVELS_DB) - 1)])


def _mix(form: Form, sums: _Sums, gain: float, notes: list[str]) -> Mix:
    weights = _weights(form, sums, notes)
    offset = float(sums.mean @ weights)
    heard = math.sqrt(max(0.0, float(weights @ sums.covariance @ weights)))
    if sums.count < form.rate / 2 or abs(offset) < max(_OFFSET, 0.1 * heard):
        offset = 0.0
    else:
        notes.append(f"its samples are off zero by {offset:.3g}, which is taken away")
    return Mix((gain * weights).astype(np.float32), gain * offset)


def _weights(form: Form, sums: _Sums, notes: list[str]) -> Float[np.ndarray, " c"]:
    """Weights of the channels, with which the mix is as loud as the loudest one."""
    covariance, count = sums.covariance, len(form.channels)
    is_heard = ~np.isin(form.channels, _RUMBLE)
    is_heard |= not np.diag(covariance)[is_heard].any()
    spreads = np.array([_level_at(channel, 0.9) - _level_at(channel, 0.1) for channel in sums.levels.T])
    is_loud = is_heard & (np.diag(covariance) > _LOUD_SHARE * np.diag(covariance)[is_heard].max())
    is_steady = is_loud & (spreads < _TONE_DB)
    if is_steady.any() and (spreads[is_loud] > _STEADY_DB).any():
        notes.append("a channel of an even sound, such as time code or hum, is left out")
        is_heard &= ~is_steady
    powers = np.where(is_heard, np.diag(covariance), 0)
    best = int(np.argmax(powers >= _ABOUT * powers.max()))
    if count == 1 or powers[best] <= 0 or sums.count < _SHORTEST_S * form.rate:
        return np.full(count, 1 / count)
    loudest = f"number {best + 1}" if form.channels[best] == "NONE" else form.channels[best]
    alone: Float[np.ndarray, " c"] = np.eye(count)[best]
    even: Float[np.ndarray, " c"] = is_heard / np.sum(is_heard)
    if sums.cancelled > _MOST_CANCELLED * sums.energies.sum():
        notes.append(f"its channels are opposed and would cancel in a mix; {loudest} alone is taken")
        return alone
    if even @ covariance @ even >= _KEPT * powers[best]:
        return even
    correlation = covariance[best] / np.sqrt(np.maximum(powers * powers[best], 1e-30))
    is_taken = (powers > _SILENT * powers[best]) & (correlation > _OPPOSED)
    weights: Float[np.ndarray, " c"] = is_taken.astype(np.float64)
    if "FC" in form.channels and is_taken[form.channels.index("FC")]:
        weights *= [_WEIGHTS.get(role, _OTHER_WEIGHT) for role in form.channels]
    power = float(weights @ covariance @ weights)
    if is_taken.sum() == 1 or power < _SILENT * powers[best]:
        notes.append(f"of its {count} channels, {loudest} alone holds the sound and is taken")
        return alone
    notes.append(f"its {count} channels are mixed by their levels, because an even mix would be too quiet")
    weights *= math.sqrt(powers[best] / power)
    return weights
