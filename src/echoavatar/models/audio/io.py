"""Sound in and out: whatever ffmpeg's libraries read (PyAV), and any stream, becomes 24 kHz mono float32.

Any rate, channel count and number format is converted, while it streams, with exact length.
"""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import soundfile
import soxr
from jaxtyping import Float, Shaped

from echoavatar.errors import AudioError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.whole_file import whole_file

from .files import Form, Piece, check_sound, decoded, usual_roles
from .mixing import Measurement, Plan

Mono = Float[np.ndarray, " s"]
_LOUDEST = 64.0  # larger floats are integers that were not scaled


def as_mono(samples: Shaped[np.ndarray, "..."], *, position: int = 0, rate: int = SAMPLE_RATE_HZ) -> Mono:
    """Check samples and mix them down: (s,) or (s, channels), floats in -1..1, signed integers or uint8.

    Args:
        samples: the sound.
        position: index of its first sample in the stream, for messages.
        rate: samples per second, for messages.

    Raises:
        AudioError: wrong shape or type; a sample that is not a number or far out of range.
    """
    if samples.ndim not in (1, 2):
        raise AudioError(f"audio of shape {samples.shape}; wanted (samples,) or (samples, channels)")
    if samples.ndim == 2 and (samples.shape[1] == 0 or (samples.shape[1] > 64 and len(samples) < samples.shape[1])):
        raise AudioError(f"audio of shape {samples.shape}; wanted (samples, channels): transpose it first")
    scaled = _scaled(samples)
    bad = ~(np.abs(scaled) <= _LOUDEST)
    if bad.any():
        row = int(np.argwhere(bad.reshape(len(scaled), -1).any(axis=1))[0, 0])
        value = scaled.reshape(len(scaled), -1)[row][bad.reshape(len(scaled), -1)[row]][0]
        place = f"audio sample {position + row} ({(position + row) / rate:.3f} s) is {value:g}"
        if np.isfinite(value):
            raise AudioError(f"{place}; floating-point audio lies in -1..1: divide integer samples by 32768")
        raise AudioError(f"{place}; replace such samples by 0 (for example with numpy.nan_to_num)")
    return scaled if scaled.ndim == 1 else np.asarray(scaled.mean(axis=1), np.float32)


def _scaled(samples: Shaped[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Float32 in -1..1; unsigned bytes are centred on 128 as in WAV files."""
    kind = samples.dtype
    if kind.kind == "f":
        return samples.astype(np.float32)
    if kind == np.uint8:
        return ((samples.astype(np.float32) - 128) / 128).astype(np.float32)
    if kind.kind == "i":
        return (samples / -float(np.iinfo(kind).min)).astype(np.float32)
    raise AudioError(f"audio samples of type {kind}; give float32 in -1..1 or int16")


class StreamResampler:
    """Pieces of sound in, 24 kHz mono out. Raises AudioError: `rate` (Hz) is not 1,000 to 768,000.

    After `flush`, exactly round(samples in * 24000 / rate) samples have come out. The filter delays the
    output by some milliseconds but does not shift it: output sample 0 is input time 0.
    """

    def __init__(self, rate: int) -> None:
        if not 1_000 <= rate <= 768_000:
            raise AudioError(f"a sample rate of {rate:,} Hz; wanted 1,000 to 768,000; correct or convert it")
        self.rate = rate
        self._given = 0
        self._returned = 0
        self._is_flushed = False
        self._soxr = None if rate == SAMPLE_RATE_HZ else soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="float32")

    def push(self, samples: Shaped[np.ndarray, "..."]) -> Mono:
        """The output that is ready after these samples: (s,) or (s, channels), see `as_mono`.

        Raises AudioError if the samples cannot be used, or the stream was flushed.
        """
        if self._is_flushed:
            raise AudioError("the audio stream has ended; open a new one")
        mono = as_mono(samples, position=self._given, rate=self.rate)
        self._given += len(mono)
        return self._resampled(mono, last=False)

    def flush(self) -> Mono:
        """The rest of the output; nothing can be pushed afterwards."""
        if self._is_flushed:
            return np.zeros(0, np.float32)
        self._is_flushed = True
        due = (2 * self._given * SAMPLE_RATE_HZ + self.rate) // (2 * self.rate) - self._returned
        rest = self._resampled(np.zeros(0, np.float32), last=True)
        return np.pad(rest, (0, max(0, due - len(rest))))[: max(0, due)]

    def _resampled(self, mono: Mono, *, last: bool) -> Mono:
        if self._soxr is not None:
            mono = np.asarray(self._soxr.resample_chunk(mono, last=last), np.float32)
        self._returned += len(mono)
        return mono


_BLOCK = 1024  # samples that are measured together
LONGEST_S = 3600  # of sound that `read_audio` reads: twice 350 MB while its pieces are joined

_LOG = logging.getLogger(__name__)


def read_audio(path: Path | str) -> Mono:
    """A whole file as 24 kHz mono, about -1..1.

    Raises AudioError: missing, empty, not sound, longer than `LONGEST_S`, or nothing in it can be decoded.
    """
    pieces: list[Mono] = []
    left = LONGEST_S * SAMPLE_RATE_HZ
    for piece in stream_audio(path):
        left -= len(piece)
        if left < 0:
            raise AudioError(f"{path} has more than {LONGEST_S // 60} minutes of sound; cut it")
        pieces.append(piece)
    return np.concatenate(pieces)


def stream_audio(path: Path | str) -> Iterator[Mono]:
    """The sound of `read_audio` in pieces as they are decoded (tens of milliseconds each): for files of any length.

    The file is decoded twice. The first time it is measured: which track and which channels hold the sound, and whether
    its level must change. The log says what was unusual. A file that breaks off is read as far as it goes. Rate and
    channels may change within it. Raises AudioError: as `read_audio`; at the first piece where the file cannot be
    opened.
    """
    path = Path(path)
    check_sound(path)
    plan = _measured(path)
    resampler: StreamResampler | None = None
    form: Form | None = None
    for piece in decoded(path, plan.track):
        try:
            if resampler is None or piece.form != form:
                if resampler is not None:
                    yield resampler.flush()
                resampler, form = StreamResampler(piece.form.rate), piece.form
            yield resampler.push(plan.mixes[piece.form](piece.samples) if form in plan.mixes else piece.samples)
        except AudioError as error:
            raise AudioError(f"{path}: {error}") from error
    if resampler is not None:
        yield resampler.flush()


def mixed(samples: Shaped[np.ndarray, "..."], *, rate: int) -> Mono:
    """A whole recording as `as_mono`, at its own rate, but measured like a file: see `stream_audio`.

    Raises AudioError: as `as_mono`.
    """
    if not len(as_mono(samples, rate=rate)):
        return np.zeros(0, np.float32)
    scaled, measurement = _scaled(samples).reshape(len(samples), -1), Measurement()
    form = Form(rate, usual_roles(scaled.shape[1]))
    for start in range(0, len(scaled), _BLOCK):
        measurement.add(Piece(0, form, scaled[start : start + _BLOCK]))
    plan = measurement.plan()
    _say(plan, "the sound")
    return plan.mixes[form](scaled)


def _measured(path: Path) -> Plan:
    """The plan for a file, measured on its first `LONGEST_S` seconds."""
    measurement, left = Measurement(), float(LONGEST_S)
    for piece in decoded(path, is_told=True):
        measurement.add(piece)
        left -= len(piece.samples) / piece.form.rate
        if left < 0:
            break
    plan = measurement.plan()
    _say(plan, path)
    return plan


def _say(plan: Plan, what: object) -> None:
    for note in plan.notes:
        _LOG.warning("%s: %s", what, note)


def write_wav(path: Path | str, audio: Mono, *, rate: int = SAMPLE_RATE_HZ) -> None:
    """Write mono 16-bit WAV, whole or not at all. Raises AudioError if the place cannot be written."""
    with whole_file(path, error=AudioError, failures=(soundfile.SoundFileError,)) as partial:
        soundfile.write(partial, np.clip(audio, -1, 1), rate, subtype="PCM_16", format="WAV")
