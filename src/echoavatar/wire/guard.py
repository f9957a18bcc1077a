"""Who may come in: a token, and pages of known origin."""

import hmac
import ipaddress
from collections.abc import Mapping
from urllib.parse import urlsplit

from .codec import ProtocolError


def check_token(expected: str, given: str, headers: Mapping[str, str]) -> None:
    """The token of the hello or of the Authorization header.

    Raises:
        ProtocolError: it is wrong.
    """
    if expected and not has_token(expected, headers) and not _same(expected, given):
        raise ProtocolError("unauthorized", "wrong token; put the server's token into hello.token")


def has_token(expected: str, headers: Mapping[str, str]) -> bool:
    """Whether the Authorization header bears the token; true where none is asked for."""
    scheme, _, bearer = headers.get("authorization", "").partition(" ")
    return not expected or (scheme.lower() == "bearer" and _same(expected, bearer.strip()))


def check_origin(headers: Mapping[str, str], allowed: tuple[str, ...]) -> None:
    """Browsers say which page connects; others say nothing and are let in.

    Without a list, a page may connect to the host that served it when that is `localhost` or a bare address, and pages
    of this machine to this machine. A name could have been pointed at us by anyone, so names must be on the list.

    Raises:
        ProtocolError: the page is not known.
    """
    origin = headers.get("origin")
    if origin is None or origin in allowed:
        return
    try:
        page, host = urlsplit(origin), urlsplit(f"//{headers.get('host', '')}")
        if page.netloc == host.netloc and _is_bare(page.hostname or ""):
            return
        if is_loopback(page.hostname or "") and is_loopback(host.hostname or ""):
            return
    except ValueError:
        pass
    raise ProtocolError(
        "forbidden_origin", f"pages of {origin[:80]} may not connect; start with --origin {origin[:80]}"
    )


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_bare(host: str) -> bool:
    try:
        return host == "localhost" or bool(ipaddress.ip_address(host))
    except ValueError:
        return False


def _same(a: str, b: str) -> bool:
    return hmac.compare_digest(a.encode(), b.encode("utf-8", "surrogatepass"))
