"""What a sink is, and the one that sends datagrams."""

import socket
from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from ..errors import EchoAvatarError


class Frame(NamedTuple):
    """What is shown at one moment, in our axes (Y up, facing +Z, left +X)."""

    rotations: Float[np.ndarray, "j 4"]  # quaternions wxyz, parent-relative
    root: Float[np.ndarray, "3"]  # metres, of the hips
    face: Float[np.ndarray, " n"] | None  # what the sink's `faces` made of the curves; None without a face
    seconds: float  # since the sink began, on its own clock
    at: int  # sample of the session's clock that is heard with it


class Sink(Protocol):
    """Shows frames somewhere. `send` may raise `OSError`; nobody waits for it but the sink's own thread."""

    rate: float  # frames per second that it wants

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """What it shows of ARKit curves (0..1, canonical order): asked once a chunk, not once a frame."""

    def send(self, frame: Frame) -> None:
        """Show a frame."""

    def close(self) -> None:
        """No more will come."""


class Encoder(Protocol):
    """A frame as datagrams."""

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """As a sink's."""

    def __call__(self, frame: Frame) -> Iterable[bytes | bytearray]:
        """In the order in which they are sent."""


class UdpSink:
    """Datagrams to one address, without ever waiting: what the network does not take at once is dropped."""

    def __init__(self, encoder: Encoder, host: str, port: int, rate: float) -> None:
        """Raises EchoAvatarError for a host whose address is not known."""
        self.rate, self.dropped, self.sent = rate, 0, 0
        self._encoder = encoder
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise EchoAvatarError(
                f"the address of {host!r} is not known ({error}); give a name or number that this machine knows"
            ) from error
        family, self._address = found[0], found[4]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if family == socket.AF_INET:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """As the encoder wants them."""
        return self._encoder.faces(curves)

    def send(self, frame: Frame) -> None:
        """Encode and send."""
        for packet in self._encoder(frame):
            try:
                self._socket.sendto(packet, self._address)
            except BlockingIOError:
                self.dropped += 1
            except OSError:
                self.dropped += 1
                raise
            else:
                self.sent += 1

    def close(self) -> None:
        """Free the socket."""
        self._socket.close()
