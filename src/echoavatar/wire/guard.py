"""Access checks: the token, the origin of browser pages, how many connections an address has, and TLS's certificate."""

import hmac
import ipaddress
import ssl
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from echoavatar.errors import EchoAvatarError

from .codec import ProtocolError

if TYPE_CHECKING:
    from anyio import CancelScope  # only servers have anyio; the proxy, too, checks origins with this module


def has_token(expected: str, headers: Mapping[str, str], given: str = "") -> bool:
    """Whether the Authorization header, or the hello, has the token; true if no token is required."""
    scheme, _, bearer = headers.get("authorization", "").partition(" ")
    return not expected or (scheme.lower() == "bearer" and _same(expected, bearer.strip())) or _same(expected, given)


def check_origin(headers: Mapping[str, str], allowed: tuple[str, ...]) -> None:
    """Check the Origin header of the page that connects. Only browsers send one; other clients are let in.

    Without an entry in `allowed`, a page may connect to the host that served it if that is `localhost` or an IP
    address, and pages of this machine to this machine. Anyone can point a host name at this server (DNS rebinding), so
    host names must be in the list. Raises ProtocolError if the page is not allowed.
    """
    origin = headers.get("origin")
    if origin is None or origin in allowed:
        return
    try:
        page, host = urlsplit(origin), urlsplit(f"//{headers.get('host', '')}")
        bare = page.hostname == "localhost" or ip_of(page.hostname or "")
        if page.netloc == host.netloc and bare:
            return
        if is_loopback(page.hostname or "") and is_loopback(host.hostname or ""):
            return
    except ValueError:
        pass
    raise ProtocolError(
        "forbidden_origin", f"pages of {origin[:80]} may not connect; start with --origin {origin[:80]}"
    )


def is_own_host(host: str, names: Collection[str]) -> bool:
    """Whether a Host header names `localhost`, an IP address or one of `names`: hosts or origins (`https://a.org`)."""
    try:
        asked = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if "@" in host:
        return False
    own = {urlsplit(name if "://" in name else f"//{name}").hostname for name in names}
    return asked == "localhost" or ip_of(asked) is not None or asked in own


def is_loopback(host: str) -> bool:
    """Whether the host can be reached from this machine only."""
    address = ip_of(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def network_of(address: str) -> str:
    """The part of an address that its holder cannot change at will: all of IPv4, the first 64 bits of IPv6."""
    found = ip_of(address.partition("%")[0])
    if found is None:
        return address
    if found.version == 4:
        return str(found)
    return str(found.ipv4_mapped or ipaddress.ip_network((int(found) >> 64 << 64, 64)))


def ip_of(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The IP address that a host is given by; None for a name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _same(a: str, b: str) -> bool:
    return hmac.compare_digest(a.encode(), b.encode("utf-8", "surrogatepass"))


def check_certificate(certificate: str, key: str | None) -> None:
    """Read a TLS certificate and its private key as the server will.

    Raises EchoAvatarError if a file is missing or damaged, the key has a password, or it is another certificate's.
    """
    for path in filter(None, (certificate, key)):
        if not Path(path).is_file():
            raise EchoAvatarError(f"file {path} does not exist; give a PEM file")
    try:  # without the empty password, OpenSSL would ask for one at the terminal
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, lambda: "")
    except (ssl.SSLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise EchoAvatarError(
            f"certificate {certificate} with key {key} cannot be used ({reason}); give two PEM files that belong "
            "together, the key without a password"
        ) from error


class Admission:
    """The open WebSockets, at most `limit`. One that has not sent its hello may have to give way to a new one.

    A WebSocket is identified by the cancel scope in which it waits for its hello.
    """

    def __init__(self, limit: int, per_address: int | None = None) -> None:
        self._limit, self._per_address = limit, per_address or limit
        self._greeted: dict[CancelScope, str] = {}  # with the client's address
        self._waiting: dict[CancelScope, str] = {}  # with the client's address, the oldest first

    def __len__(self) -> int:
        return len(self._greeted) + len(self._waiting)

    def enter(self, scope: "CancelScope", address: str) -> bool:
        """Admit a connection; returns False if there is no room.

        An address that is at its own limit gives up its oldest connection without hello. If all places are taken, the
        address with the most connections without hello gives one up.
        """
        address = network_of(address)
        own = [*self._waiting.values(), *self._greeted.values()].count(address)
        if own >= self._per_address or len(self) >= self._limit:
            waiting = Counter(self._waiting.values())
            busiest = address if own >= self._per_address else max(waiting, key=lambda one: waiting[one], default="")
            oldest = next((scope for scope, held in self._waiting.items() if held == busiest), None)
            if oldest is None:
                return False
            del self._waiting[oldest]
            oldest.cancel()
        self._waiting[scope] = address
        return True

    def greet(self, scope: "CancelScope") -> None:
        """The connection said hello, so it keeps its place."""
        address = self._waiting.pop(scope, None)
        if address is not None:
            self._greeted[scope] = address

    def leave(self, scope: "CancelScope") -> None:
        """The connection is closed."""
        self._waiting.pop(scope, None)
        self._greeted.pop(scope, None)
