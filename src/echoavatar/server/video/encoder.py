"""H.264 and AAC into a file or to an RTMP server, by FFmpeg, in this process or in one of its own.

FFmpeg holds Python's lock while it connects to a server and waits for it: one that accepts and is silent would stop the
whole process, its Ctrl-C too. So `broadcast` runs this file as a program where the stream leaves the machine, and kills
it when it hangs. The program imports nothing else of the package, so that it starts in a moment. It reads its settings
as a line of JSON, then pictures and sounds, each a line of JSON before its bytes. It prints `open`, and at its end
`closed`, or the failure without the address.
"""

import json
import signal
import sys
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import av
import numpy as np

CLOCK_HZ = 1_000  # clock of pictures: FLV counts milliseconds
KEY_S = 2  # between key frames, as streaming servers require
OPENED, CLOSED = "open", "closed"


class Encoder:
    """One stream. Its methods raise OSError or `av.FFmpegError`, whose text may hold the address: see `reason`."""

    def __init__(self, to: str, container: str, size: Sequence[int], rate: int, sound_rate: int) -> None:
        self._last, self._sound_rate = -1, sound_rate
        self._container = av.open(to, "w", format=container)
        self._video = self._container.add_stream("libx264", rate=rate)
        self._sound = self._container.add_stream("aac", rate=sound_rate, layout="mono")
        assert isinstance(self._video, av.VideoStream)
        assert isinstance(self._sound, av.AudioStream)
        self._video.width, self._video.height, self._video.pix_fmt = size[0], size[1], "yuv420p"
        self._video.codec_context.time_base = Fraction(1, CLOCK_HZ)
        self._video.codec_context.gop_size = KEY_S * rate
        self._video.options = {"preset": "veryfast", "tune": "zerolatency", "crf": "22"}
        self._container.start_encoding()

    def write(self, seconds: float, data: np.ndarray) -> None:
        """Encode and send a picture, (height, width, 3) uint8, or a sound, (samples,) int16, of that second."""
        if data.ndim == 3:
            picture = av.VideoFrame.from_ndarray(data, format="rgb24")
            picture.pts = self._last = max(self._last + 1, round(seconds * CLOCK_HZ))
            picture.time_base = Fraction(1, CLOCK_HZ)
            self._container.mux(self._video.encode(picture))
            return
        sound = av.AudioFrame.from_ndarray(data[None].astype("f4") / 32_768, format="fltp", layout="mono")
        sound.sample_rate, sound.pts = self._sound_rate, round(seconds * self._sound_rate)
        sound.time_base = Fraction(1, self._sound_rate)
        self._container.mux(self._sound.encode(sound))

    def close(self) -> None:
        """Send the rest, and end the file or connection."""
        try:
            for stream in (self._video, self._sound):
                self._container.mux(stream.encode(None))
        finally:
            self._container.close()


def reason(error: Exception) -> str:
    """What FFmpeg says of an error, without the address that its own text holds."""
    return str(getattr(error, "strerror", None) or type(error).__name__)


def main() -> None:
    """Encode what comes on standard input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the other process ends this one
    source: Any = sys.stdin.buffer
    try:
        encoder = Encoder(*json.loads(source.readline()))
        print(OPENED, flush=True)  # noqa: T201
        while head := source.readline():
            told = json.loads(head)
            data = np.frombuffer(source.read(told["bytes"]), told["type"]).reshape(told["shape"])
            encoder.write(told["seconds"], data)
        encoder.close()
        print(CLOSED, flush=True)  # noqa: T201
    except (OSError, av.FFmpegError) as error:
        print(reason(error), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
