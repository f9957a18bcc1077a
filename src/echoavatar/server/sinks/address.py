"""Addresses of sinks, with options: `vmc://127.0.0.1:39539?rate=60&names=perfect`."""

from dataclasses import dataclass, field
from typing import cast
from urllib.parse import parse_qsl, urlsplit

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.messages import Rig

from .encoders import NAMES, JsonEncoder, LiveLinkEncoder, Names, VmcEncoder
from .sink import Encoder, Sink, UdpSink

PORTS = {"vmc": 39_539, "livelink": 11_111, "json": 39_570, "unity": 12_346}
RATES = {"vmc": 60.0, "livelink": 60.0, "json": 30.0}
OPTIONS = {"vmc": ("rate", "names"), "livelink": ("rate", "subject"), "json": ("rate",), "unity": ()}
EXAMPLE = "vmc://127.0.0.1:39539, livelink://192.168.1.7:11111, json://127.0.0.1:39570"


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
        EchoAvatarError: unknown protocol, missing host, invalid port, or an option that the protocol does not have.
    """
    parts = urlsplit(text)
    if parts.scheme not in PORTS:
        raise EchoAvatarError(f"sink {text!r} is of no known kind ({', '.join(PORTS)}); give one such as {EXAMPLE}")
    try:
        port = parts.port
    except ValueError:
        port = 0
    if not parts.hostname or port == 0 or parts.path.strip("/"):
        raise EchoAvatarError(f"sink {text!r} is not {parts.scheme}://HOST:PORT; give one such as {EXAMPLE}")
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    known = OPTIONS[parts.scheme]
    if unknown := sorted(set(options) - set(known)):
        choice = f"only {', '.join(known)}" if known else "no options"
        raise EchoAvatarError(f"sink {text!r} has no option {unknown[0]!r}; {parts.scheme} has {choice}")
    return Address(parts.scheme, parts.hostname, port or PORTS[parts.scheme], options)


def check_address(text: str) -> None:
    """Check that `make_sink` would accept the address, before a rig is known.

    Raises:
        EchoAvatarError: see `make_sink`.
    """
    make_sink(text, Rig(names=("hips",), parents=(-1,), rest=((0.0, 0.0, 0.0),))).close()


def make_sink(text: str, rig: Rig) -> Sink:
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
