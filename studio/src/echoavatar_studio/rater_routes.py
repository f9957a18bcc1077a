"""The routes of raters' pages: join, consent, the next task, its sound and clips, an answer."""

import re
from functools import partial
from pathlib import Path
from typing import cast

import msgspec
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute

from . import joining, judging
from .errors import StudioError
from .http import COOKIES, HEADERS, Call, Gate, decoded, reply
from .sessions import RATER_SECONDS, Visitor, sign_out
from .store import Store
from .tables import Rater
from .wire_rater import Answer, Consent, Done, Join, Withdraw

PATH = "/api/rater"
_LONG_AGO = "Thu, 01 Jan 1970 00:00:00 GMT"
_KEY = re.compile(r"[A-Za-z0-9_-]{8,64}")
_MEDIA = HEADERS | {"cache-control": "private, max-age=3600", "content-disposition": "inline"}


def rater_routes(gate: Gate, media: Path) -> list[BaseRoute]:
    """All routes of raters; `media` is the folder of sounds and clips."""
    store = gate.store
    add = partial(gate.route, who="rater")
    return [
        add("POST", f"{PATH}/join", partial(_join, gate), signed=False),
        add("GET", f"{PATH}/me", lambda call: joining.rejoined(store, call.signed)),
        add("POST", f"{PATH}/consent", partial(_consent, store)),
        add("GET", f"{PATH}/task", lambda call: judging.next_task(store, call.signed)),
        add("GET", PATH + "/tasks/{task}/audio", partial(_media, store, media)),
        add("GET", PATH + "/tasks/{task}/clips/{slot}", partial(_media, store, media)),
        add("POST", PATH + "/tasks/{task}/answer", partial(_judge, store), rate=gate.rates.answer),
        add("POST", f"{PATH}/withdraw", partial(_withdraw, store)),
        add("POST", f"{PATH}/leave", partial(_leave, store)),
    ]


def _join(gate: Gate, call: Call) -> Response:
    gate.check_rate(f"join {call.address}", gate.rates.join)
    asked = decoded(call, Join)
    cookie, joined = joining.join(gate.store, asked.token, call.visitor, page=call.page("rate"))
    answer = reply(joined)
    set_cookie(answer, call, COOKIES["rater"], cookie, PATH, RATER_SECONDS)
    return answer


def _consent(store: Store, call: Call) -> msgspec.Struct:
    if decoded(call, Consent).agreed:
        return joining.agree(store, call.signed)
    _forget(store, call.signed, "did not consent")
    raise StudioError("not_signed_in", "nothing was kept; the link opens the study again while there is room")


def _judge(store: Store, call: Call) -> msgspec.Struct:
    key = call.request.headers.get("idempotency-key", "")
    if not _KEY.fullmatch(key):
        raise StudioError("bad_request", "the header Idempotency-Key takes 8 to 64 of A-Z a-z 0-9 _ -")
    answer = decoded(call, cast("type[Answer]", Answer))
    return judging.judge(store, call.signed, call.public("task"), key, answer)


def _media(store: Store, folder: Path, call: Call) -> Response:
    slot = call.number("slot") if "slot" in call.request.path_params else None
    path = judging.media_path(folder, judging.media_of(store, call.signed, call.public("task"), slot))
    kind = "audio/flac" if slot is None else "application/msgpack"
    answer = FileResponse(path, media_type=kind, headers=_MEDIA, stat_result=path.stat())
    # an ETag of the clip itself would reveal that two tasks show the same clip
    answer.headers["etag"], answer.headers["last-modified"] = f'"{call.public("task")}-{slot}"', _LONG_AGO
    return answer


def _withdraw(store: Store, call: Call) -> msgspec.Struct:
    decoded(call, Withdraw)
    _forget(store, call.signed, "withdrew")
    return Done()


def _leave(store: Store, call: Call) -> msgspec.Struct:
    sign_out(store, call.signed)
    return Done()


def _forget(store: Store, visitor: Visitor, why: str) -> None:
    with store.write() as session:
        rater = session.get_one(Rater, visitor.rater_id)
        joining.delete_rater(session, rater, actor=f"rater {rater.number}", why=why)


def set_cookie(answer: Response, call: Call, name: str, token: str, path: str, seconds: float) -> None:
    """A cookie that scripts cannot read and other sites cannot send."""
    is_secure = call.request.url.scheme == "https"
    answer.set_cookie(name, token, max_age=int(seconds), path=path, httponly=True, samesite="strict", secure=is_secure)
