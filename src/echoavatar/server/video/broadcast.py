"""Where a stream goes beside WebRTC: a virtual camera of this machine, or a file or RTMP server through FFmpeg."""

import errno
import json
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import av
import numpy as np

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.outgoing import redacted
from echoavatar.timing import SAMPLE_RATE_HZ

from . import encoder
from .encoder import Encoder, reason
from .live_stream import Block, Picture, doubled

FORMATS = {".flv": "flv", ".mp4": "mp4", ".mkv": "matroska", ".ts": "mpegts"}
SCHEMES = {"rtmp": "flv", "rtmps": "flv"}
SOUND_RATE_HZ = 2 * SAMPLE_RATE_HZ
OPEN_S, WRITE_S = 10.0, 10.0  # for a server to answer, and to take a picture or sound
STOP_S = 1.0


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
            self.name = str(self._camera.device)
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

    def stop(self) -> None:
        """A camera does not hang."""

    def close(self) -> None:
        """Give the camera back."""
        self._camera.close()


class Broadcast:
    """A file, or a stream to an RTMP server."""

    def __init__(self, to: str, size: Sequence[int], rate: int) -> None:
        """Raises EchoAvatarError for an address of another kind, or one that cannot be opened."""
        self.name = redacted(to)
        # With "file:", FFmpeg does not take the 10: of 10:30.mp4 for a protocol.
        kind, place = (_Distant, to) if "://" in to else (Encoder, f"file:{to}")
        with self._naming_itself():
            self._encoder = kind(place, container_of(to), size, rate, SOUND_RATE_HZ)

    def show(self, picture: Picture) -> None:
        """Encode and send a picture."""
        with self._naming_itself():
            self._encoder.write(picture.seconds, picture.pixels)

    def hear(self, block: Block) -> None:
        """Encode and send 20 ms of sound."""
        with self._naming_itself():
            self._encoder.write(block.seconds, doubled(block.samples))

    def stop(self) -> None:
        """Let a call that hangs end within a second."""
        if isinstance(self._encoder, _Distant):
            self._encoder.stop()

    def close(self) -> None:
        """Send the rest, and end the file or connection."""
        with self._naming_itself():
            self._encoder.close()

    @contextmanager
    def _naming_itself(self) -> Iterator[None]:
        """FFmpeg's errors become EchoAvatarError with the address in it, but not the key of the stream."""
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            raise EchoAvatarError(
                f"cannot send to {self.name} ({reason(error)}); check the address, and that something listens"
            ) from error


class _Distant:
    """An `Encoder` in a process of its own, which is killed when it hangs. Its errors do not hold the address."""

    def __init__(self, *settings: Any) -> None:
        program = [sys.executable, "-P", encoder.__file__]
        self._process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._failure = ""
        try:
            self._ask(OPEN_S, settings, wanted=encoder.OPENED)
        except BaseException:
            self._end()
            raise

    def write(self, seconds: float, data: np.ndarray) -> None:
        """See `Encoder.write`."""
        told = {"seconds": seconds, "type": data.dtype.str, "shape": data.shape, "bytes": data.nbytes}
        self._ask(WRITE_S, told, data.tobytes())

    def stop(self) -> None:
        """End within a second, whether all is sent or not."""
        self._alarm(STOP_S)

    def close(self) -> None:
        """See `Encoder.close`."""
        try:
            self._ask(WRITE_S, None, wanted=encoder.CLOSED)
        finally:
            self._end()

    def _ask(self, seconds: float, told: object, data: bytes = b"", *, wanted: str | None = None) -> None:
        """Send a line and its bytes (None: end the input) and wait for the word `wanted`, if any; OSError: too late."""
        pipe, answers = self._process.stdin, self._process.stdout
        assert pipe is not None
        assert answers is not None
        alarm = self._alarm(seconds)
        try:
            if told is None:
                pipe.close()
            else:
                pipe.write(json.dumps(told).encode() + b"\n" + data)
                pipe.flush()
            said = answers.readline().decode().strip() if wanted else None
        except OSError:  # the process has ended
            said = answers.readline().decode().strip()
        finally:
            alarm.cancel()
        if said != wanted:
            self._failure = self._failure or said or f"it takes nothing for {seconds:g} s"
            raise OSError(errno.EPIPE, self._failure)

    def _alarm(self, seconds: float) -> threading.Timer:
        alarm = threading.Timer(seconds, self._process.kill)
        alarm.daemon = True
        alarm.start()
        return alarm

    def _end(self) -> None:
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()
        self._process.wait()


def container_of(to: str) -> str:
    """The container of an address.

    Raises EchoAvatarError if it is neither an RTMP address nor a file of a known kind.
    """
    scheme = to.partition("://")[0] if "://" in to else ""
    found = SCHEMES.get(scheme) if scheme else FORMATS.get(Path(to).suffix.lower())
    if found is None:
        raise EchoAvatarError(
            f"--to {redacted(to)} is neither rtmp://HOST/APP/KEY nor a file ending in {', '.join(FORMATS)}"
        )
    return found
