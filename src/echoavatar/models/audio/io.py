"""Sound files in and out: whatever ffmpeg's libraries read (PyAV) becomes 24 kHz mono float32.

May import `resample`, `timing`, `limits` and `errors`.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import soundfile
from av.container import InputContainer
from jaxtyping import Float

from echoavatar.errors import AudioError
from echoavatar.limits import check_file
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.whole_file import whole_file

from .resample import StreamResampler

# Containers that hold their own sound. ffmpeg's libraries also know playlists, concat lists, SDP and MPD. Those are
# texts that name other files or addresses, which would be opened.
_CONTAINERS = (
    "aac,ac3,aiff,amr,ape,asf,au,avi,caf,dts,eac3,flac,flv,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,mp3,mpeg,mpegts,mpc,mpc8"
    ",oga,ogg,opus,rf64,rm,tta,voc,w64,wav,wv"
)
_OPTIONS = {"format_whitelist": _CONTAINERS, "protocol_whitelist": "file"}
_LARGEST_BYTES = 1 << 40
LONGEST_S = 6 * 3600  # of sound that is read whole: two gigabytes

_LOG = logging.getLogger(__name__)

Mono = Float[np.ndarray, " s"]


def read_audio(path: Path | str) -> Mono:
    """A whole file as 24 kHz mono, about -1..1.

    Raises:
        AudioError: missing, empty, not sound, longer than `LONGEST_S`, or nothing in it can be decoded.
    """
    pieces: list[Mono] = []
    left = LONGEST_S * SAMPLE_RATE_HZ
    for piece in stream_audio(path):
        left -= len(piece)
        if left < 0:
            raise AudioError(f"{path} has more than {LONGEST_S // 3600} hours of sound; cut it")
        pieces.append(piece)
    return np.concatenate(pieces)


def stream_audio(path: Path | str) -> Iterator[Mono]:
    """The same in pieces as they are decoded (tens of milliseconds each): for files of any length.

    A file that breaks off is read as far as it goes, and the log says so.

    Raises:
        AudioError: as `read_audio`; at the first piece where the file cannot be opened.
    """
    path = Path(path)
    if not path.exists():
        raise AudioError(f"{path} does not exist; check the path")
    if path.is_dir():
        raise AudioError(f"{path} is a folder; name a sound file in it")
    check_file(path, _LARGEST_BYTES, AudioError)
    if path.stat().st_size == 0:
        raise AudioError(f"{path} is empty (0 bytes); copy or record it again")
    resampler: StreamResampler | None = None
    given = 0
    for piece, rate in _decoded(path):
        resampler = resampler or StreamResampler(rate)
        given += len(piece)
        try:
            yield resampler.push(piece)
        except AudioError as error:
            raise AudioError(f"{path}: {error}") from error
    if resampler is None or not given:
        raise AudioError(f"{path} holds no sound that can be decoded; convert it to WAV first")
    yield resampler.flush()


def write_wav(path: Path | str, audio: Mono, *, rate: int = SAMPLE_RATE_HZ) -> None:
    """Write mono 16-bit WAV, whole or not at all.

    Raises:
        AudioError: the place cannot be written.
    """
    with whole_file(path, error=AudioError, failures=(soundfile.SoundFileError,)) as partial:
        soundfile.write(partial, np.clip(audio, -1, 1), rate, subtype="PCM_16", format="WAV")


def open_sound(path: Path) -> InputContainer:
    """Open a sound or video file that holds its own sound; raises av.FFmpegError for anything else."""
    return av.open(str(path), metadata_errors="ignore", options=dict(_OPTIONS))


def _decoded(path: Path) -> Iterator[tuple[Float[np.ndarray, "s c"], int]]:
    """Float pieces (samples, channels) at the file's own rate."""
    try:
        with open_sound(path) as container:
            if not container.streams.audio:
                raise AudioError(f"{path} has no sound track; choose a file with sound")
            yield from _frames(container, path)
    except av.FFmpegError as error:
        raise AudioError(f"{path} is not a sound file that ffmpeg's libraries can read ({error.strerror})") from error


def _frames(container: Any, path: Path) -> Iterator[tuple[Float[np.ndarray, "s c"], int]]:
    stream = container.streams.audio[0]
    converter: av.AudioResampler | None = None
    packets, broken = container.demux(stream), 0
    while True:
        try:
            packet = next(packets, None)
            frames = [] if packet is None else packet.decode()
        except av.FFmpegError as error:
            broken += 1
            if broken == 1:
                _LOG.warning("%s is damaged (%s); decoding what is there", path, error.strerror)
            if broken > 100:
                return
            continue
        if packet is None:
            return
        for frame in frames:
            # Packed samples: PyAV reads beyond the list of planes where there are more than eight.
            converter = converter or av.AudioResampler(format="flt", layout=frame.layout, rate=frame.sample_rate)
            for converted in converter.resample(frame):
                yield converted.to_ndarray().reshape(converted.samples, -1), converted.sample_rate
