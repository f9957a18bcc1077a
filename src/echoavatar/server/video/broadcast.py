"""Where a stream goes beside WebRTC: a virtual camera of this machine, or a file or RTMP server through FFmpeg."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ

from .live_stream import Block, Picture, doubled

FORMATS = {".flv": "flv", ".mp4": "mp4", ".mkv": "matroska", ".ts": "mpegts"}
SCHEMES = {"rtmp": "flv", "rtmps": "flv"}
SOUND_RATE_HZ = 2 * SAMPLE_RATE_HZ
CLOCK_HZ = 1_000  # of pictures: FLV counts milliseconds
KEY_S = 2  # between key frames, as streaming servers require


class VirtualCamera:
    """A camera that other programs can choose. It carries no sound."""

    def __init__(self, size: Sequence[int], rate: int) -> None:
        """Raises DependencyError where this machine has no virtual camera."""
        try:
            import pyvirtualcam
        except ModuleNotFoundError as error:
            raise DependencyError("a virtual camera needs pyvirtualcam: pip install 'echoavatar[camera]'") from error
        try:
            self._camera: Any = pyvirtualcam.Camera(size[0], size[1], rate)
            self.name = str(self._camera.device)  # as other programs list it
        except RuntimeError as error:
            raise DependencyError(
                "this machine has no virtual camera; Linux: `sudo modprobe v4l2loopback`; Windows and macOS: install "
                f"OBS and start its virtual camera once ({str(error).splitlines()[0][:120]})"
            ) from error

    def show(self, picture: Picture) -> None:
        """Show a picture."""
        self._camera.send(picture.pixels)

    def hear(self, block: Block) -> None:
        """A camera has no sound."""

    def close(self) -> None:
        """Give the camera back."""
        self._camera.close()


class Broadcast:
    """H.264 and AAC into a file or to an RTMP server."""

    def __init__(self, to: str, size: Sequence[int], rate: int) -> None:
        """Raises EchoAvatarError for an address of another kind, or one that cannot be opened."""
        self.name, self._last = to, -1
        with self._naming_itself():
            self._container = av.open(to, "w", format=container_of(to))
            self._video = self._container.add_stream("libx264", rate=rate)
            self._sound = self._container.add_stream("aac", rate=SOUND_RATE_HZ, layout="mono")
            assert isinstance(self._video, av.VideoStream)
            assert isinstance(self._sound, av.AudioStream)
            self._video.width, self._video.height, self._video.pix_fmt = size[0], size[1], "yuv420p"
            self._video.codec_context.time_base = Fraction(1, CLOCK_HZ)
            self._video.codec_context.gop_size = KEY_S * rate
            self._video.options = {"preset": "veryfast", "tune": "zerolatency", "crf": "22"}
            self._container.start_encoding()

    def show(self, picture: Picture) -> None:
        """Encode and send a picture; raises EchoAvatarError where the address takes no more."""
        frame = av.VideoFrame.from_ndarray(picture.pixels, format="rgb24")
        frame.pts, frame.time_base = max(self._last + 1, round(picture.seconds * CLOCK_HZ)), Fraction(1, CLOCK_HZ)
        self._last = frame.pts
        self._mux(self._video, frame)

    def hear(self, block: Block) -> None:
        """Encode and send 20 ms of sound."""
        samples = doubled(block.samples).astype("f4")[None] / 32_768
        frame = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
        frame.sample_rate, frame.pts = SOUND_RATE_HZ, round(block.seconds * SOUND_RATE_HZ)
        frame.time_base = Fraction(1, SOUND_RATE_HZ)
        self._mux(self._sound, frame)

    def close(self) -> None:
        """Send the rest, and end the file or connection."""
        try:
            for stream in (self._video, self._sound):
                self._mux(stream, None)
        finally:
            with self._naming_itself():
                self._container.close()

    def _mux(self, stream: Any, frame: Any) -> None:
        with self._naming_itself():
            self._container.mux(stream.encode(frame))

    @contextmanager
    def _naming_itself(self) -> Iterator[None]:
        """FFmpeg's errors become EchoAvatarError with the address in it."""
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            raise EchoAvatarError(
                f"cannot send to {self.name} ({error}); check the address, and that something listens"
            ) from error


Output = VirtualCamera | Broadcast  # their methods may block, and one thread calls them


def container_of(to: str) -> str:
    """The container of an address.

    Raises:
        EchoAvatarError: it is neither an RTMP address nor a file of a known kind.
    """
    scheme = to.partition("://")[0] if "://" in to else ""
    found = SCHEMES.get(scheme) if scheme else FORMATS.get(Path(to).suffix.lower())
    if found is None:
        raise EchoAvatarError(f"--to {to} is neither rtmp://HOST/APP/KEY nor a file ending in {', '.join(FORMATS)}")
    return found
