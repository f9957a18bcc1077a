"""The shared parts of the studio's HTTP API: base messages, errors, questions, limits.

JSON in, JSON out; unknown fields of requests are refused. `docs/studio.md` lists the routes with their messages, which
are in `wire_rater` and `wire_owner`; `wire_types` makes the TypeScript types of the pages from them.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

ErrorCode = Literal[
    "bad_request",
    "too_large",
    "not_signed_in",
    "bad_login",
    "bad_invitation",
    "bad_csrf",
    "bad_origin",
    "needs_consent",
    "not_found",
    "already_judged",
    "key_reused",
    "study_closed",
    "study_full",
    "busy",
    "too_many_requests",
    "internal",
]
STATUS: dict[ErrorCode, int] = {
    "bad_request": 400,
    "not_signed_in": 401,
    "bad_login": 401,
    "bad_invitation": 401,
    "bad_csrf": 403,
    "bad_origin": 403,
    "needs_consent": 403,
    "not_found": 404,
    "already_judged": 409,
    "key_reused": 409,
    "study_closed": 409,
    "study_full": 409,
    "busy": 409,
    "too_large": 413,
    "too_many_requests": 429,
    "internal": 500,
}

Kind = Literal["preference", "pairwise"]
Presentation = Literal["side_by_side", "sequential"]
Stage = Literal["training", "rating"]
Question = Literal["human_likeness", "beat_matching", "overall_preference"]
QUESTIONS: tuple[Question, ...] = ("human_likeness", "beat_matching", "overall_preference")
Category = Literal["dance", "gesture"]
CATEGORIES: tuple[Category, ...] = ("dance", "gesture")
StudyState = Literal["making", "open", "closed", "failed"]
MAX_REQUEST_BYTES = 1 << 16
MAX_CLIPS = 16


class Request(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message from a page."""


class Reply(Struct, frozen=True, kw_only=True):
    """A message from the studio."""


class Problem(Reply, frozen=True, kw_only=True):
    """Every answer that is not 2xx."""

    code: ErrorCode
    message: Annotated[str, Meta(description="English, for people; pages translate `code`")]
    retry_after: Annotated[float, Meta(description="seconds; 0: trying again will not help")] = 0.0
