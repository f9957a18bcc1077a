"""The sound formats in which voice agents send speech: what their names mean, and their samples at 24 kHz."""

import io
import re

import numpy as np
import soundfile
import soxr
from jaxtyping import Int16

from echoavatar.timing import SAMPLE_RATE_HZ

Pcm = Int16[np.ndarray, " _s"]  # mono; lengths of several blocks may differ
Format = tuple[str, int]  # encoding and rate; an encoding that is none of `READABLE` keeps its own name
READABLE = ("pcm", "ulaw", "alaw")
_NAMES = {  # parts of the names that vendors use
    "ulaw": ("ulaw", "mu-law", "mu_law", "\u03bc-law", "pcmu"),
    "alaw": ("alaw", "a-law", "a_law", "pcma"),
    "": ("f32", "float", "s24", "s32", "16be"),
    "pcm": ("pcm", "l16", "linear16", "s16", "raw"),
}
_FILES = (b"RIFF", b"OggS", b"ID3", b"fLaC", b"\x1aE\xdf\xa3")  # first bytes of sound files


def named_format(name: str, rate: object = None) -> Format:
    """The format of a name such as `pcm16`, `pcm16_8000hz`, `audio/pcmu`, `ulaw_8000` or `raw-16khz-16bit-mono-pcm`.

    `rate` wins over one in the name. Without any, telephone codes have 8,000 Hz and PCM has 24,000 Hz. Names with
    several channels are not readable.
    """
    low = name.casefold()
    kind = next((kind for kind, parts in _NAMES.items() if any(part in low for part in parts)), "") or low
    in_name = re.search(r"(?<![\d.])(\d{4,6})(?!\d)|(?<![\d.])(\d{1,3}(?:\.\d+)?) ?k(?!b)", low)
    usual = SAMPLE_RATE_HZ if kind == "pcm" else 8_000
    if re.search(r"stereo|channels=0*(?:[2-9]|1\d)", low):
        kind = low
    for asked in (rate, in_name and (in_name[1] or 1000 * float(in_name[2]))):
        try:
            number = float(asked)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            continue
        if 8_000 <= number <= 192_000 and number.is_integer():
            return kind, int(number)
    return kind, usual


def is_file(data: bytes) -> bool:
    """Whether the bytes begin like a sound file, not like samples."""
    return data.startswith(_FILES)


class Decoder:
    """Decodes one stream of one format to 24 kHz mono; interleaved channels of PCM are averaged."""

    def __init__(self, kind: str = "pcm", rate: int = SAMPLE_RATE_HZ, channels: int = 1) -> None:
        self._kind, self._channels = kind, channels
        self._rest = b""  # an incomplete sample at the end of the last block
        self._stream = None
        if rate != SAMPLE_RATE_HZ:
            self._stream = soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="int16", quality="HQ")

    def push(self, data: bytes, *, is_last: bool = False) -> Pcm:
        """Decode the next bytes; `is_last` also flushes the resampler."""
        if self._kind == "pcm":
            data = self._rest + data
            whole = len(data) // (2 * self._channels) * 2 * self._channels
            self._rest = data[whole:]
            samples = np.frombuffer(data[:whole], "<i2")
            if self._channels > 1:
                samples = samples.reshape(-1, self._channels).mean(axis=1).astype(np.int16)
        else:
            samples = _TABLES[self._kind][np.frombuffer(data, np.uint8)]
        if self._stream is None:
            return samples
        made: Pcm = self._stream.resample_chunk(samples, last=is_last)
        return made


def _table(kind: str) -> Pcm:
    """The sample of each of the 256 codes."""
    codes = io.BytesIO(bytes(range(256)))
    table: Pcm
    table, _ = soundfile.read(codes, dtype="int16", samplerate=8_000, channels=1, format="RAW", subtype=kind.upper())
    return table


_TABLES = {kind: _table(kind) for kind in ("ulaw", "alaw")}
