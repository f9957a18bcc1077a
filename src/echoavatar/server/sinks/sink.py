"""Sinks, and their addresses with options: `vmc://127.0.0.1:39539?rate=60&names=perfect`."""

import socket
from contextlib import suppress
from dataclasses import dataclass, field
from typing import cast
from urllib.parse import parse_qsl

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.outgoing import address_parts
from echoavatar.wire.messages import Rig

from .encoders import NAMES, Encoder, Frame, JsonEncoder, LiveLinkEncoder, Names, VmcEncoder

PORTS = {"vmc": 39_539, "livelink": 11_111, "json": 39_570, "unity": 12_346}
RATES = {"vmc": 60.0, "livelink": 60.0, "json": 30.0}
OPTIONS = {"vmc": ("rate", "names"), "livelink": ("rate", "subject"), "json": ("rate",), "unity": ()}
EXAMPLE = "vmc://127.0.0.1:39539, livelink://192.168.1.7:11111, json://127.0.0.1:39570"


class UdpSink:
    """Sends datagrams to one address without blocking; packets that the network does not accept at once are dropped.

    Only the sink's own thread calls its methods.
    """

    def __init__(self, encoder: Encoder, host: str, port: int, rate: float) -> None:
        """`rate` is the wanted number of frames per second. Raises EchoAvatarError if the host cannot be resolved."""
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
        """Convert ARKit curves (0..1, canonical order) to the receiver's own; called per chunk, not per frame."""
        return self._encoder.faces(curves)

    def send(self, frame: Frame) -> None:
        """Encode and send a frame; raises OSError where the network fails."""
        for packet in self._encoder(frame):
            with suppress(BlockingIOError):
                self._socket.sendto(packet, self._address)

    def close(self) -> None:
        """Close the socket; no more frames will come."""
        self._socket.close()


@dataclass(frozen=True)
class Address:
    """A parsed address."""

    scheme: str
    host: str
    port: int
    options: dict[str, str] = field(default_factory=dict)


def parse_address(text: str) -> Address:
    """Parse an address; the default port is that of its protocol.

    Raises:
        EchoAvatarError: unknown protocol, missing host, a path, invalid port, or an option that the protocol lacks.
    """
    if (scheme := text.partition(":")[0].lower()) not in PORTS:
        raise EchoAvatarError(f"sink {text!r} is of no known kind ({', '.join(PORTS)}); give one such as {EXAMPLE}")
    parts = address_parts(text, scheme)
    if parts is None or parts.path.strip("/"):
        raise EchoAvatarError(f"sink {text!r} is not {scheme}://HOST:PORT; give one such as {EXAMPLE}")
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    known = OPTIONS[parts.scheme]
    if unknown := sorted(set(options) - set(known)):
        choice = f"only {', '.join(known)}" if known else "no options"
        raise EchoAvatarError(f"sink {text!r} has no option {unknown[0]!r}; {parts.scheme} has {choice}")
    return Address(parts.scheme, parts.hostname or "", parts.port or PORTS[parts.scheme], options)


def check_address(text: str) -> None:
    """Check that `make_sink` would accept the address, before a rig is known; raises as `make_sink`."""
    make_sink(text, Rig(names=("hips",), parents=(-1,), rest=((0.0, 0.0, 0.0),))).close()


def make_sink(text: str, rig: Rig) -> UdpSink:
    """Create the sink for an address.

    Raises:
        EchoAvatarError: the address is not valid, the rate is not 1 to 240, or the names or the host are unknown.
    """
    address = parse_address(text)
    if address.scheme == "unity":
        raise EchoAvatarError("unity:// needs a server of its own: `echoavatar serve --sink unity://HOST:PORT`")
    rate = _rate(text, address.options.get("rate", str(RATES[address.scheme])))
    encoder: Encoder
    if address.scheme == "vmc":
        names = address.options.get("names", "vrm0")
        if names not in NAMES:
            raise EchoAvatarError(f"sink {text!r}: names are one of {', '.join(NAMES)}, not {names!r}")
        encoder = VmcEncoder(rig, cast(Names, names))
    elif address.scheme == "livelink":
        encoder = LiveLinkEncoder(rig, subject=address.options.get("subject", "EchoAvatar"), rate=rate)
    else:
        encoder = JsonEncoder(rig)
    return UdpSink(encoder, address.host, address.port, rate)


def _rate(text: str, word: str) -> float:
    try:
        rate = float(word)
    except ValueError:
        rate = 0.0
    if not 1 <= rate <= 240:
        raise EchoAvatarError(f"sink {text!r}: rate {word!r} is not between 1 and 240 frames per second")
    return rate
