"""Messages between raters' pages and the studio.

These messages reveal nothing about models, seeds, other raters or the design: tasks have random names, and the clips
of a task are numbered in the order in which the rater sees them.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from .wire import MAX_CLIPS, Kind, Presentation, Question, Reply, Request, Stage

Token = Annotated[str, Meta(min_length=16, max_length=128)]
Slot = Annotated[int, Meta(ge=0, lt=MAX_CLIPS, description="place of a clip in `RaterTask.clips`")]
Rating = Annotated[
    int, Meta(ge=-2, le=2, description="-2 clip 0 is much better, 0 no difference, 2 clip 1 is much better")
]
Seconds = Annotated[float, Meta(ge=0, le=86_400)]
Count = Annotated[int, Meta(ge=0, le=10_000)]


class Join(Request, frozen=True, kw_only=True):
    """An invitation, or the rater's own key from `Joined.resume`: the part of the link behind `#`."""

    token: Token


class StudyFace(Reply, frozen=True, kw_only=True):
    """What a rater may know of a study."""

    title: str
    kind: Kind
    language: Annotated[str, Meta(description="of the page, such as en")]
    intro: Annotated[str, Meta(description="what the owner wrote for raters, plain text")]
    consent: Annotated[str, Meta(description="to be agreed to before the first task, plain text")]
    presentation: Annotated[Presentation, Meta(description="pairwise; in preference studies a grid")]
    questions: Annotated[tuple[Question, ...], Meta(description="pairwise: to be answered, in this order")]
    min_plays: Annotated[int, Meta(description="each clip is to be played so often before an answer")]


class Progress(Reply, frozen=True, kw_only=True):
    """The progress of this rater."""

    done: Annotated[int, Meta(description="tasks answered or skipped, training included")]
    of: int
    is_finished: bool


class Joined(Reply, frozen=True, kw_only=True):
    """Answer to `join` and `me`."""

    csrf: Annotated[str, Meta(description="for the header X-CSRF-Token of every POST")]
    study: StudyFace
    has_consented: bool
    progress: Progress
    resume: Annotated[
        str, Meta(description="link to go on with elsewhere; only when an open invitation was just taken, else empty")
    ] = ""


class Consent(Request, frozen=True, kw_only=True):
    """The rater has read the text and agrees."""

    agreed: bool


class RaterTask(Reply, frozen=True, kw_only=True):
    """One task to judge."""

    id: Annotated[str, Meta(description="random; part of the addresses below")]
    stage: Annotated[Stage, Meta(description="training: practice, does not count")]
    number: Annotated[int, Meta(description="1 is the first task")]
    seconds: Annotated[float, Meta(description="length of sound and of every clip")]
    audio: Annotated[str, Meta(description="address of the sound, audio/flac")]
    clips: Annotated[tuple[str, ...], Meta(description="addresses of the motion: 2 (pairwise) or N (preference)")]
    first: Annotated[int, Meta(description="sequential: which of the two clips is played first")]


class NextTask(Reply, frozen=True, kw_only=True):
    """The rater's current task; the same until it is answered, in every tab and on every device."""

    task: RaterTask | None
    ahead: Annotated[RaterTask | None, Meta(description="the one after it, to be loaded meanwhile")]
    progress: Progress


class PairwiseAnswer(Request, frozen=True, kw_only=True, tag="pairwise", tag_field="type"):
    """All questions of the study, each once."""

    ratings: Annotated[dict[Question, Rating], Meta(max_length=3)]
    seconds: Annotated[Seconds, Meta(description="from the task's first picture to the answer")]
    plays: Annotated[tuple[Count, ...], Meta(max_length=MAX_CLIPS, description="times each clip was begun")]


class PreferenceAnswer(Request, frozen=True, kw_only=True, tag="preference", tag_field="type"):
    """Best and worst, which must differ."""

    best: Slot
    worst: Slot
    seconds: Seconds
    plays: Annotated[tuple[Count, ...], Meta(max_length=MAX_CLIPS)]


class SkipAnswer(Request, frozen=True, kw_only=True, tag="skip", tag_field="type"):
    """No clear difference (preference), or it cannot be judged (a clip does not play)."""

    reason: Literal["no_difference", "cannot_play"]
    seconds: Seconds
    plays: Annotated[tuple[Count, ...], Meta(max_length=MAX_CLIPS)]


Answer = PairwiseAnswer | PreferenceAnswer | SkipAnswer


class Saved(Reply, frozen=True, kw_only=True):
    """The judgement is on disk. The same key again gives the same answer with `is_repeated`."""

    is_repeated: bool
    progress: Progress


class Withdraw(Request, frozen=True, kw_only=True):
    """Delete all answers of this rater."""

    sure: Literal[True]


class Done(Reply, frozen=True, kw_only=True):
    """The request was carried out; there is nothing to return."""

    ok: bool = True


class RigInfo(Reply, frozen=True, kw_only=True):
    """The rig that the clips move, for `AvatarDriver.bind` of @echoavatar/client."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: Annotated[tuple[tuple[float, float, float], ...], Meta(description="offset from the parent, metres")]


class Scene(Reply, frozen=True, kw_only=True):
    """Answer to `GET /api/scene`, the same for every rater."""

    rig: RigInfo
    face: Annotated[tuple[str, ...], Meta(description="ARKit names, in the order of a clip's face curves")]
    frame_rate: int
    avatar: Annotated[str, Meta(description="address of the character's GLB")]


RATER_REQUESTS: tuple[type[Struct], ...] = (Join, Consent, PairwiseAnswer, PreferenceAnswer, SkipAnswer, Withdraw)
RATER_REPLIES: tuple[type[Struct], ...] = (Joined, NextTask, Saved, Done, Scene)
