"""The one HTTP client for outgoing requests: to language models, speech services, the hub and avatar servers.

A request goes to the origin in its URL and to no other. The whole exchange has a limit of seconds and of bytes.
`proxy_for` chooses the proxy, also for WebSockets. No error message shows a key, not even where the answer repeats it.
Client libraries of vendors do not go through this module. Uses `json_reader` and `errors` only.
"""

import http.client
import ipaddress
import json
import os
import re
import socket
import string
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from email.message import Message
from typing import Any
from urllib.parse import SplitResult, quote, unquote, urlsplit

from .errors import EchoAvatarError
from .json_reader import read_json

SILENCE_S = 120.0  # without a byte, after which a connection counts as dead even in a longer exchange
SECONDS = 30.0  # of an exchange, from the first byte of the request to the last of the answer
MOST_BYTES = 4 << 20  # of an answer
SHOWN_LETTERS = 200  # characters of a server's refusal that an error message shows
_READ_BYTES = 4_096  # of a refusal that are read
_PIECE = 8  # so many characters in a row of a key are hidden in messages
_BLOCK = 1 << 16
PROXY_PRIVATE = "ECHOAVATAR_PROXY_PRIVATE"  # environment variable: hosts in private networks use the proxy, too
HTTP_PROXIES_ONLY = "name an HTTP proxy in HTTPS_PROXY, or the host in NO_PROXY"
_PROXIES = {  # names in the environment, without `_PROXY`, by scheme; the first that is set counts
    "http": ("http", "all"),
    "https": ("https", "all"),
    "ws": ("ws", "socks", "https", "http", "all"),
    "wss": ("wss", "socks", "https", "all"),
}
_LOCAL_NAMES = re.compile(r"(.+\.)?(localhost|local)\.?", re.IGNORECASE)  # private, without asking a resolver
_SECRET_NAME = re.compile("auth|key|password|secret|sig|token", re.IGNORECASE)  # of headers and of a query's values
_USER = re.compile(r"(\w://)\S*@")
_QUERY = re.compile(r"(\w://[^\s?#]*)[?#]\S*")
_STREAM_KEY = re.compile(r"(rtmp\w*://[^\s/]*/).*", re.IGNORECASE | re.DOTALL)
_LOWER = str.maketrans(string.ascii_uppercase, string.ascii_lowercase)
_CONTROL = re.compile(r"[\s\x00-\x1f\x7f-\x9f]+")


class OutgoingError(EchoAvatarError):
    """A request failed. The message shows no secret, and no error that could show one is chained to it."""

    def __init__(self, message: str, *, status: int = 0, said: str = "", headers: Message | None = None) -> None:
        """`status` is the HTTP status, 0 without an answer; `said` is the start of the answer's body, redacted."""
        super().__init__(message)
        self.status, self.said, self.headers = status, said, headers or Message()


class Answer:
    """An answer whose body is still to be read. Close it, or use it in a `with` statement."""

    def __init__(self, call: "_Call", response: http.client.HTTPResponse) -> None:
        self.status = response.status
        self._call, self._response = call, response

    def __enter__(self) -> "Answer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def blocks(self) -> Iterator[bytes]:
        """The body in pieces, as they arrive. Raises OutgoingError: the connection broke, or the time limit is over."""
        while block := self._call.attempt(lambda: self._response.read1(_BLOCK)):
            yield block
        if self._response.length:
            raise OutgoingError(f"{self._call.shown} ended its answer {self._response.length:,} bytes early")

    def close(self) -> None:
        """End the exchange."""
        self._call.clock.stop()
        self._response.close()


def opened(
    url: str,
    body: object = None,
    *,
    headers: Mapping[str, str] | None = None,
    method: str | None = None,
    seconds: float = SECONDS,
) -> Answer:
    """Send a request. A body that is not bytes is sent as JSON.

    A redirect is followed only from a GET and within its origin.

    Raises:
        EchoAvatarError: the URL is not one of HTTP, or holds a user or password.
        OutgoingError: no answer came, or the server refuses, or redirects elsewhere.
    """
    parts = _web_address(url)
    given = {name.lower(): value for name, value in (headers or {}).items()}
    if body is not None and not isinstance(body, bytes):
        body = json.dumps(body).encode()
        given.setdefault("content-type", "application/json")
    call = _Call(url, parts, given, seconds)
    try:
        return Answer(call, call.attempt(lambda: call.send(body, given, method)))
    except BaseException:
        call.clock.stop()
        raise


def fetch(url: str, body: object = None, *, most: int = MOST_BYTES, **request: Any) -> bytes:
    """The whole answer to a request, with the arguments and errors of `opened`.

    Raises OutgoingError: also where the answer breaks off or is longer than `most`.
    """
    got = bytearray()
    with opened(url, body, **request) as answer:
        for block in answer.blocks():
            got += block
            if len(got) > most:
                raise OutgoingError(f"{redacted(url)} sends more than {most:,} bytes", status=answer.status)
    return bytes(got)


def ask(url: str, body: object = None, **request: Any) -> Any:
    """The JSON value of an answer, None for an empty one; errors as `fetch`, and OutgoingError: it is not JSON."""
    got = fetch(url, body, **request)
    return read_json(got, f"the answer of {redacted(url)}", error=OutgoingError) if got.strip() else None


def redacted(text: str, secrets: Iterable[str] = ()) -> str:
    """One line of text without secrets: the given ones, also in pieces, and those in URLs.

    Of a URL the user, the password and the query are hidden, and of RTMP also the path, which holds the stream key.
    """
    for secret in secrets:
        for form in (secret, quote(secret, safe="", errors="replace"), json.dumps(secret)[1:-1]):
            text = _without(text, form)
    for pattern in (_USER, _QUERY, _STREAM_KEY):
        text = pattern.sub(r"\1...", text)
    return _CONTROL.sub(" ", text).strip()


def is_private(host: str) -> bool:
    """Whether a host is this machine, or one of a private network. Looks the name up."""
    if _LOCAL_NAMES.fullmatch(host):
        return True
    host = host.partition("%")[0]  # without the network card
    try:
        found = {str(entry[4][0]).partition("%")[0] for entry in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return False  # the name is unknown here; a proxy may know it
    return any(not ipaddress.ip_address(address.removeprefix("::ffff:")).is_global for address in found)


def proxy_for(url: str) -> str | None:
    """The address of the proxy through which a URL is asked for; None: directly. May look the host up.

    The proxy is the one that the environment or the system names (`HTTPS_PROXY`, `ALL_PROXY` and so on). Hosts in
    `NO_PROXY` are asked directly, and so are private ones, unless `ECHOAVATAR_PROXY_PRIVATE` is set.
    """
    parts, named = urlsplit(url), urllib.request.getproxies()
    proxy = next((named[name] for name in _PROXIES.get(parts.scheme, ()) if named.get(name)), None)
    host = parts.hostname or ""
    if proxy is None or urllib.request.proxy_bypass(parts.netloc.rpartition("@")[2]):
        return None
    if not os.environ.get(PROXY_PRIVATE) and is_private(host):
        return None
    if proxy == named.get("socks") or proxy.startswith("socks:"):
        return f"socks5h://{proxy.rpartition('://')[2]}"
    return proxy if "://" in proxy else f"http://{proxy}"


class _Clock:
    """Cuts an exchange when its time is over, even while bytes still arrive slowly."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.is_over = seconds, False
        self._end = time.monotonic() + seconds
        self._lines: list[socket.socket] = []
        self._timer = threading.Timer(seconds, self._cut)
        self._timer.daemon = True
        self._timer.start()

    def dial(self, address: tuple[str, int], _: object = None, source: Any = None) -> socket.socket:
        """Connect, in place of `socket.create_connection`."""
        seconds = min(SILENCE_S, max(self._end - time.monotonic(), 0.001))
        line = socket.create_connection(address, seconds, source)
        self._lines.append(line.dup())  # TLS takes the socket itself over
        if self.is_over:
            self._cut()
        return line

    def stop(self) -> None:
        """End the watch; the exchange is over."""
        self._timer.cancel()
        for line in self._lines:
            line.close()

    def _cut(self) -> None:
        self.is_over = True
        for line in self._lines:
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)


class _Call:
    """One exchange: sends the request, and turns errors into messages without secrets."""

    def __init__(self, url: str, parts: SplitResult, headers: Mapping[str, str], seconds: float) -> None:
        self.shown, self.clock = redacted(url), _Clock(seconds)
        self._url = url
        self._secrets = [value.rpartition(" ")[2] for name, value in headers.items() if _SECRET_NAME.search(name)]
        for name, _, value in (pair.partition("=") for pair in parts.query.split("&")):
            if _SECRET_NAME.search(name):
                self._secrets += [value, unquote(value)]

    def send(self, body: Any, headers: Mapping[str, str], method: str | None) -> http.client.HTTPResponse:
        """Send it, and return the answer once its headers are there."""
        proxy = proxy_for(self._url)
        if proxy is not None and not proxy.startswith("http"):
            raise OutgoingError(f"{self.shown} is behind the proxy {redacted(proxy)}; {HTTP_PROXIES_ONLY}")
        proxies = {} if proxy is None else {urlsplit(self._url).scheme: proxy}
        opener = urllib.request.build_opener(urllib.request.ProxyHandler(proxies), _Timed(self.clock), _SameOrigin())
        opener.addheaders = [("user-agent", "echoavatar")]
        request = urllib.request.Request(self._url, body, dict(headers), method=method)
        answer: http.client.HTTPResponse = opener.open(request)
        return answer

    def attempt(self, step: Callable[[], Any]) -> Any:
        """Take a step of the exchange; whatever it raises becomes one error without secrets."""
        try:
            done = step()
            if not self.clock.is_over:
                return done
            failure = self._no_answer(TimeoutError())
        except urllib.error.HTTPError as error:
            failure = self._refusal(error)
        except (OSError, http.client.HTTPException, ValueError) as error:
            failure = self._no_answer(error)
        raise failure  # not in the handler, whose error would be chained to it

    def _refusal(self, error: urllib.error.HTTPError) -> OutgoingError:
        try:
            said = error.read(_READ_BYTES).decode(errors="replace")
        except (OSError, http.client.HTTPException, ValueError):
            said = ""
        error.close()
        if 300 <= error.code < 400:
            place = re.match(r"\w+://(?:[^/?#]*@)?([^/?#]+)", str(error.headers.get("location", "")))
            host = place[1] if place else "another address"
            said = f"it redirects to {host}, where no request of ours is sent; give the address of the service itself"
        said = redacted(said, self._secrets)
        message = f"{self.shown} answers HTTP {error.code}" + (f": {said[:SHOWN_LETTERS]}" if said else "")
        return OutgoingError(message, status=error.code, said=said, headers=error.headers)

    def _no_answer(self, error: Exception) -> OutgoingError:
        cause = getattr(error, "reason", error)
        why = getattr(cause, "strerror", None) or type(cause).__name__
        if self.clock.is_over or isinstance(cause, TimeoutError):
            why = f"nothing whole within {self.clock.seconds:g} s"
        return OutgoingError(f"{self.shown} does not answer ({redacted(why, self._secrets)})")


class _Timed(urllib.request.HTTPHandler, urllib.request.HTTPSHandler):
    """Opens connections that a clock watches."""

    def __init__(self, clock: _Clock) -> None:
        super().__init__()
        self._clock = clock

    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_timed(http.client.HTTPConnection, self._clock), req)

    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_timed(http.client.HTTPSConnection, self._clock), req)


class _SameOrigin(urllib.request.HTTPRedirectHandler):
    def redirect_request(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        """Follow a GET within its origin; any other redirect becomes an HTTPError."""
        if req.get_method() != "GET" or origin(newurl) != origin(req.full_url):
            return None
        fp.close()  # otherwise its whole body would be read, however long it is
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def origin(url: str) -> tuple[str, str, int]:
    """Scheme, host and port of a URL. Raises EchoAvatarError if it is not a URL of HTTP."""
    parts = _web_address(url)
    return parts.scheme, parts.hostname or "", parts.port or {"http": 80, "https": 443}[parts.scheme]


def address_parts(url: str, *schemes: str) -> SplitResult | None:
    """The parts of a URL with one of these schemes; None for other schemes, and if host or port is invalid."""
    with suppress(ValueError):
        parts = urlsplit(url)
        if parts.scheme in schemes and parts.hostname and parts.hostname.encode("idna") and parts.port != 0:
            return parts
    return None


def _web_address(url: str) -> SplitResult:
    parts = address_parts(url, "http", "https")
    if parts is None:
        raise EchoAvatarError(f"{redacted(url)!r} is not a web address; give one that begins with https:// or http://")
    if "@" in parts.netloc:
        raise EchoAvatarError(f"{redacted(url)} holds a user or password; leave it out and give the key by itself")
    return parts


def _timed(kind: type[http.client.HTTPConnection], clock: _Clock) -> Any:
    def build(host: str, **options: Any) -> http.client.HTTPConnection:
        connection = kind(host, **options)
        connection._create_connection = clock.dial  # type: ignore[attr-defined]
        return connection

    return build


def _without(text: str, secret: str) -> str:
    """The text with `...` in place of every piece of the secret."""
    width = min(_PIECE, len(secret))
    low, secret = text.translate(_LOWER), secret.translate(_LOWER)
    pieces = {secret[at : at + width] for at in range(len(secret) - width + 1)} - {""}
    hidden = {at + k for at in range(len(text)) if low[at : at + width] in pieces for k in range(width)}
    return re.sub("\0+", "...", "".join("\0" if at in hidden else letter for at, letter in enumerate(text)))
