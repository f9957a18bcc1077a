"""The interface of a sink, and a sink that sends datagrams."""

import socket
from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError


class Frame(NamedTuple):
    """What is shown at one moment, in our axes (Y up, facing +Z, left +X)."""

    rotations: Float[np.ndarray, "j 4"]  # quaternions wxyz, parent-relative
    root: Float[np.ndarray, "3"]  # metres, of the hips
    face: Float[np.ndarray, " n"] | None  # the result of the sink's `faces`; None without a face
    seconds: float  # since the sink started, on its own clock
    at: int  # sample of the session's clock that is heard with it


class Sink(Protocol):
    """Shows frames somewhere. `send` may raise `OSError`; only the sink's own thread calls it."""

    rate: float  # wanted frames per second

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """Convert ARKit curves (0..1, canonical order) to the sink's own; called per chunk, not per frame."""

    def send(self, frame: Frame) -> None:
        """Show a frame."""

    def close(self) -> None:
        """Release resources; no more frames will come."""


class Encoder(Protocol):
    """Encodes a frame as datagrams."""

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """See `Sink.faces`."""

    def __call__(self, frame: Frame) -> Iterable[bytes | bytearray]:
        """The frame's datagrams, in the order in which they are sent."""


class UdpSink:
    """Sends datagrams to one address without blocking; packets that the network does not accept at once are dropped."""

    def __init__(self, encoder: Encoder, host: str, port: int, rate: float) -> None:
        """Raises EchoAvatarError if the host cannot be resolved."""
        self.rate = rate
        self._encoder = encoder
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise EchoAvatarError(
                f"host {host!r} cannot be resolved ({error}); give a host name or IP address"
            ) from error
        family, self._address = found[0], found[4]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if family == socket.AF_INET:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """See `Sink.faces`."""
        return self._encoder.faces(curves)

    def send(self, frame: Frame) -> None:
        """Encode and send a frame."""
        for packet in self._encoder(frame):
            with suppress(BlockingIOError):
                self._socket.sendto(packet, self._address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
