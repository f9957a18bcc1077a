"""The checks of every API request (limits, origin, session, CSRF, body), then its handler, in a thread of its own.

Every failure is answered with a `Problem`. Suspicious refusals also leave a line in the audit.
"""

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar
from urllib.parse import urlsplit

import anyio.to_thread
import msgspec
from sqlalchemy.exc import IntegrityError, NoResultFound
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route

from echoavatar.wire.guard import network_of
from echoavatar.wire.rates import Limiter, Rate

from .audit import note
from .errors import StoreAwayError, StudioError, not_found
from .secrecy import is_name, is_same
from .sessions import Visitor, find_visitor, name_of
from .store import Store
from .wire import MAX_REQUEST_BYTES

_LOG = logging.getLogger(__name__)
T = TypeVar("T")
Who = Literal["rater", "owner"]
COOKIES: dict[Who, str] = {"rater": "studio_rater", "owner": "studio_owner"}
_QUIET = {  # normal answers to a page that works as intended
    "needs_consent",
    "already_judged",
    "study_closed",
    "study_full",
    "busy",
    "internal",
}
_AUDIT_RATE = Rate(30, 30)  # a flood of refusals must not fill the store
_AWAY_RATE = Rate(1, 1)  # lines in the log while the store is away
HEADERS = {"cache-control": "no-store", "x-content-type-options": "nosniff", "referrer-policy": "no-referrer"}


@dataclass(frozen=True)
class Rates:
    """The limits of an address, a session or an account."""

    login: Rate = Rate(8, 6)  # per address
    join: Rate = Rate(60, 60)  # per address: a whole classroom may join through one router
    answer: Rate = Rate(30, 60)  # per rater
    read: Rate = Rate(400, 1200)  # per session, clips and sounds included
    stranger: Rate = Rate(120, 240)  # per address, for requests without a session
    account: Rate = Rate(100, 60)  # sign-ins to one account from addresses that never succeeded


@dataclass(frozen=True)
class Call:
    """A request that passed all checks."""

    request: Request
    visitor: Visitor | None
    address: str  # of the caller, for limits only
    body: bytes = b""

    @property
    def signed(self) -> Visitor:
        """The visitor, on a route that needs a session."""
        assert self.visitor is not None
        return self.visitor

    def page(self, name: str) -> str:
        """The address of one of our pages, as the caller sees it."""
        return f"{self.request.url.scheme}://{self.request.headers.get('host', '')}/{name}"

    def word(self, name: str) -> str:
        """A text parameter of the path."""
        return str(self.request.path_params[name])

    def public(self, name: str) -> str:
        """The public name of a study or a task in the path.

        Raises:
            StudioError: it cannot be the name of anything.
        """
        text = self.word(name)
        if not is_name(text):
            raise not_found()
        return text

    def number(self, name: str) -> int:
        """A number in the path.

        Raises:
            StudioError: it is no number, or one that no row can have.
        """
        text = self.word(name)
        if not re.fullmatch("[0-9]{1,9}", text):
            raise not_found()
        return int(text)


Work = Callable[[Call], msgspec.Struct | Response]


class Gate:
    """Builds routes with all checks."""

    def __init__(self, store: Store, *, rates: Rates | None = None, origins: tuple[str, ...] = ()) -> None:
        self.store, self.rates, self._origins = store, rates or Rates(), origins
        self.limiter = Limiter()

    def route(
        self, method: str, path: str, work: Work, *, who: Who, signed: bool = True, rate: Rate | None = None
    ) -> Route:
        """A route for raters or owners. `signed`: it needs a session, and changes need the CSRF token."""

        async def endpoint(request: Request) -> Response:
            return await self._answer(request, work, who, signed, rate)

        return Route(path, endpoint, methods=[method])

    def check_rate(self, key: str, rate: Rate) -> None:
        """Count a request towards its limit.

        Raises:
            StudioError: too many of them.
        """
        if wait := self.limiter.wait(key, rate):
            raise StudioError("too_many_requests", "too many requests; wait a little", retry_after=round(wait, 1))

    async def _answer(self, request: Request, work: Work, who: Who, signed: bool, rate: Rate | None) -> Response:
        try:
            return await self._answer_from_store(request, work, who, signed, rate)
        except StoreAwayError as away:
            if not self.limiter.wait("store away", _AWAY_RATE):
                _LOG.error("the studio cannot reach its data; requests get 503: %s", away.reason)
            return refused(away)

    async def _answer_from_store(
        self, request: Request, work: Work, who: Who, signed: bool, rate: Rate | None
    ) -> Response:
        visitor: Visitor | None = None
        try:
            call = await self._admit(request, who, signed, rate)
            visitor = call.visitor
            done = await anyio.to_thread.run_sync(work, call)
            return done if isinstance(done, Response) else reply(done)
        except StoreAwayError:
            raise
        except OSError as error:  # the folder with sounds and clips is away
            raise StoreAwayError(str(error)) from error
        except StudioError as refusal:
            visitor = visitor or getattr(request.state, "visitor", None)
            if _is_mischief(refusal, who, request):
                await anyio.to_thread.run_sync(self._note, request, visitor, refusal)
            return refused(refusal)
        except NoResultFound:  # deleted while the request was on its way
            return refused(StudioError("not_signed_in", "this session has ended; open your link again"))
        except IntegrityError as error:
            _LOG.warning("a change met another: %s", error.orig)
            return refused(StudioError("busy", "somebody else changed this at the same moment; try again"))
        except ClientDisconnect:
            return Response(status_code=499)
        except Exception:
            _LOG.exception("%s %s failed", request.method, request.url.path)
            return refused(StudioError("internal", "the studio made a mistake; it is in the server's log"))

    async def _admit(self, request: Request, who: Who, signed: bool, rate: Rate | None) -> Call:
        address = _address(request)
        changes = request.method not in ("GET", "HEAD")
        if changes:
            self._check_origin(request)
        token = request.cookies.get(COOKIES[who], "")
        visitor = await anyio.to_thread.run_sync(find_visitor, self.store, token) if token else None
        request.state.visitor = visitor  # the audit names the visitor
        if visitor is not None and not visitor.is_a(who):
            visitor = None  # a rater's token in the owners' cookie opens nothing
        if visitor is None:
            self.check_rate(f"stranger {address}", self.rates.stranger)
        else:
            self.check_rate(f"session {visitor.login_id}", self.rates.read)
            if rate is not None:
                self.check_rate(f"{rate} {visitor.login_id}", rate)
        if signed and visitor is None:
            raise StudioError("not_signed_in", "no session; open your link again, or sign in")
        if signed and changes and visitor is not None:
            self._check_csrf(request, visitor)
        return Call(request, visitor, address, await read_body(request) if changes else b"")

    def _check_csrf(self, request: Request, visitor: Visitor) -> None:
        if not is_same(request.headers.get("x-csrf-token", ""), visitor.csrf):
            raise StudioError("bad_csrf", "the header X-CSRF-Token is missing or of another session")

    def _check_origin(self, request: Request) -> None:
        origin = request.headers.get("origin")
        if origin is None or origin in self._origins:
            return
        try:
            page = urlsplit(origin).netloc
        except ValueError:
            page = ""
        if not page or page != request.headers.get("host", ""):
            raise StudioError("bad_origin", "pages of another address may not do this; see --origin")

    def _note(self, request: Request, visitor: Visitor | None, refusal: StudioError) -> None:
        who = f"login {visitor.login_id}" if visitor else _address(request)
        if self.limiter.wait(f"audit {who}", _AUDIT_RATE):
            return
        with self.store.write() as session:
            actor, study = name_of(session, visitor)
            what = f"{request.method} {request.url.path[:200]}: {refusal}"
            note(session, actor, f"refused: {refusal.code}", study=study, detail=what)


def _address(request: Request) -> str:
    return network_of(request.client.host) if request.client else ""


def _is_mischief(refusal: StudioError, who: Who, request: Request) -> bool:
    """Whether a refusal goes into the audit. Expired sessions and the owner page's first `me` are normal and do not."""
    if refusal.code == "not_signed_in":
        return who == "owner" and not request.url.path.endswith("/me")
    return refusal.code not in _QUIET


async def read_body(request: Request) -> bytes:
    """Read the body of a request that changes something.

    Raises:
        StudioError: the body is too long, or its header does not say JSON.
    """
    declared = request.headers.get("content-length", "0")
    body = b""
    if declared.isdigit() and int(declared) <= MAX_REQUEST_BYTES:
        async for part in request.stream():
            body += part
            if len(body) > MAX_REQUEST_BYTES:
                break
        else:
            kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
            if body and kind != "application/json":
                raise StudioError("bad_request", "send JSON, with Content-Type: application/json")
            return body
    raise StudioError("too_large", f"a request has at most {MAX_REQUEST_BYTES} bytes")


def decoded(call: Call, kind: type[T]) -> T:
    """Decode the body as a message.

    Raises:
        StudioError: the body is not such a message.
    """
    if b"\\u0000" in call.body:  # PostgreSQL stores no NUL, and no path has one
        raise StudioError("bad_request", "text may not hold NUL characters")
    try:
        return msgspec.json.decode(call.body, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise StudioError("bad_request", f"the body is not valid: {str(error)[:200]}") from error


def reply(message: msgspec.Struct, status: int = 200) -> Response:
    """A message as JSON."""
    return Response(msgspec.json.encode(message), status, media_type="application/json", headers=HEADERS)


def refused(refusal: StudioError) -> Response:
    """A refusal as JSON."""
    answer = reply(refusal.problem, refusal.status)
    if refusal.retry_after:
        answer.headers["retry-after"] = str(max(1, round(refusal.retry_after)))
    return answer


def nothing_here(_: Request, __: Exception) -> Response:
    """Turn Starlette's answer for unknown addresses and methods into a `Problem`."""
    return refused(StudioError("not_found", "there is no such address"))
