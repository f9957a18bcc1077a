"""Sound files that tests encode themselves: any codec, layout and number of tracks."""

from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np


def talk(rate: int, seconds: float = 2.0) -> np.ndarray:
    """Bursts of a tone with pauses, as loud as speech (-16 dB while it sounds)."""
    time = np.arange(round(rate * seconds)) / rate
    return (0.22 * np.sin(2 * np.pi * 440 * time) * (np.sin(2 * np.pi * 2.5 * time) > -0.3)).astype(np.float32)


def level_db(samples: np.ndarray) -> float:
    """RMS in dB of full scale."""
    return float(10 * np.log10(np.mean(np.square(samples, dtype=np.float64)) + 1e-20))


def encode(
    path: Path,
    codec: str,
    samples: np.ndarray | Sequence[np.ndarray],
    rate: int,
    *,
    layout: str = "mono",
    container: str | None = None,
    bit_rate: int = 128_000,
    options: dict[str, str] | None = None,
) -> Path:
    """Write samples (s) or (s, channels), or a track for each array in a list."""
    tracks = [samples] if isinstance(samples, np.ndarray) else samples
    with av.open(f"file:{path}", "w", format=container, options=options or {}) as file:
        streams = [file.add_stream(codec, rate=rate, layout=layout) for _ in tracks]
        for stream in streams:
            stream.bit_rate = bit_rate
        for stream, track in zip(streams, tracks, strict=True):
            context = stream.codec_context
            cut = av.AudioResampler(context.format.name, layout, rate, context.frame_size or 1_024)
            frame = av.AudioFrame.from_ndarray(track.astype(np.float32).reshape(1, -1), format="flt", layout=layout)
            frame.sample_rate = rate
            for piece in [*cut.resample(frame), *cut.resample(None)]:
                file.mux(stream.encode(piece))
        for stream in streams:
            file.mux(stream.encode(None))
    return path


def joined(path: Path, *parts: Path) -> Path:
    """The bytes of several files one after another, as `cat` pastes them."""
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    return path


def with_sizes(path: Path, riff: int, data: int) -> Path:
    """Write other sizes into the header of a WAV, as programs do that stream."""
    content = bytearray(path.read_bytes())
    place = content.index(b"data") + 4
    content[4:8], content[place : place + 4] = riff.to_bytes(4, "little"), data.to_bytes(4, "little")
    path.write_bytes(content)
    return path


def tagged(path: Path, picture: int) -> Path:
    """Put an ID3 tag with a cover of this many bytes before the sound."""
    cover = b"\0image/jpeg\0\3\0\xff\xd8" + bytes(np.random.default_rng(0).integers(0, 256, picture, np.uint8))
    frame = b"APIC" + len(cover).to_bytes(4) + b"\0\0" + cover
    size = bytes((len(frame) >> shift) & 127 for shift in (21, 14, 7, 0))
    path.write_bytes(b"ID3\3\0\0" + size + frame + path.read_bytes())
    return path
