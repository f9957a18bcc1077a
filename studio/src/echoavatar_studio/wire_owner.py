"""Messages between owners' pages and the studio."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from .wire import Category, Kind, Question, Reply, Request, StudyState

Name = Annotated[str, Meta(min_length=1, max_length=128)]
Text = Annotated[str, Meta(max_length=2000)]


class Login(Request, frozen=True, kw_only=True):
    """An owner's name and password."""

    name: Name
    password: Annotated[str, Meta(min_length=1, max_length=256)]


class OwnerSession(Reply, frozen=True, kw_only=True):
    """Answer to `login` and `me`."""

    name: str
    csrf: str


class Making(Reply, frozen=True, kw_only=True):
    """Progress of making the clips of a new study."""

    done: int
    of: int
    what: str


class StudyRow(Reply, frozen=True, kw_only=True):
    """A study in the list."""

    id: str
    title: str
    kind: Kind
    state: StudyState
    created: Annotated[str, Meta(description="ISO 8601, UTC")]
    making: Making | None
    problem: Annotated[str, Meta(description="why making failed; else empty")]
    raters: Annotated[int, Meta(description="who joined")]
    raters_wanted: int
    judgements: Annotated[int, Meta(description="that count: no training, no checks")]
    judgements_wanted: int


class StudyList(Reply, frozen=True, kw_only=True):
    """All studies, newest first."""

    studies: tuple[StudyRow, ...]


class SystemRow(Reply, frozen=True, kw_only=True):
    """One of the systems that are compared."""

    name: str
    source: str
    clips: int
    judgements: int


class CellRow(Reply, frozen=True, kw_only=True):
    """Live progress of one category."""

    category: Category
    sounds: int
    done: int
    of: int


class StudyDetail(Reply, frozen=True, kw_only=True):
    """One study in full."""

    study: StudyRow
    settings: Annotated[str, Meta(description="study.yaml as it was taken")]
    systems: tuple[SystemRow, ...]
    progress: tuple[CellRow, ...]
    per_hour: Annotated[tuple[int, ...], Meta(description="judgements in each of the last 24 hours, oldest first")]


class NewStudy(Request, frozen=True, kw_only=True):
    """Set-up in the page: the text of a study.yaml. Paths are below the studio's library folder."""

    settings: Annotated[str, Meta(min_length=1, max_length=20_000)]


class Template(Reply, frozen=True, kw_only=True):
    """A commented study.yaml to begin with."""

    kind: Kind
    settings: str


class SetUp(Reply, frozen=True, kw_only=True):
    """What a study can be made of: answer to `GET /api/owner/setup`."""

    templates: tuple[Template, ...]
    models: Annotated[tuple[str, ...], Meta(description="names of bundles, shipped and in the library")]
    folders: Annotated[tuple[str, ...], Meta(description="folders of clips in the library")]
    sounds: Annotated[tuple[str, ...], Meta(description="sound files and folders in the library")]


class ChangeState(Request, frozen=True, kw_only=True):
    """Open or close a study for raters."""

    state: Literal["open", "closed"]


class Invite(Request, frozen=True, kw_only=True):
    """New links: `count` personal ones, or one open link for so many raters."""

    count: Annotated[int, Meta(ge=1, le=500)] = 1
    is_open: bool = False
    label: Annotated[str, Meta(max_length=80)] = ""


class Link(Reply, frozen=True, kw_only=True):
    """A link, shown only once: the studio keeps only a hash."""

    id: int
    url: str


class Invited(Reply, frozen=True, kw_only=True):
    """The new links."""

    links: tuple[Link, ...]


class InvitationRow(Reply, frozen=True, kw_only=True):
    """An invitation as the owner sees it later."""

    id: int
    label: str
    is_open: bool
    seats: int
    taken: int
    is_revoked: bool
    created: str


class Invitations(Reply, frozen=True, kw_only=True):
    """All invitations of a study."""

    invitations: tuple[InvitationRow, ...]


class RaterRow(Reply, frozen=True, kw_only=True):
    """One rater's work, by number; there are no names."""

    id: int
    label: Annotated[str, Meta(description="of the invitation")]
    joined: str
    last_seen: str
    has_consented: bool
    done: int
    of: int
    checks_passed: int
    checks_failed: int
    skipped: int
    median_seconds: float
    too_fast: Annotated[int, Meta(description="answers given before the clips could have been seen")]
    straight: Annotated[float, Meta(description="share of the commonest answer; 1: always the same")]
    agreement: Annotated[float | None, Meta(description="correlation with the others' mean; null: too little")]
    is_excluded: Annotated[bool, Meta(description="left out of results and export")]
    reason: str


class Raters(Reply, frozen=True, kw_only=True):
    """All raters of a study."""

    raters: tuple[RaterRow, ...]


class Exclude(Request, frozen=True, kw_only=True):
    """Exclude a rater from the results, or include them again."""

    is_excluded: bool
    reason: Text = ""


class Mean(Reply, frozen=True, kw_only=True):
    """A mean with its 95 % interval: mean - half to mean + half; null below two observations."""

    mean: float
    half: Annotated[float | None, Meta(description="over judgements, as in the paper")]
    half_raters: Annotated[float | None, Meta(description="over raters' own means: mind it where raters differ")]
    count: int


class ResultRow(Reply, frozen=True, kw_only=True):
    """A system's scores: positive is preferred."""

    system: str
    group: Annotated[str, Meta(description="heading of the table's rows; only systems of a group met")]
    category: Category
    scores: dict[Question, Mean]


class PairRow(Reply, frozen=True, kw_only=True):
    """One system against another; positive: the first is preferred."""

    first: str
    second: str
    category: Category
    scores: dict[Question, Mean]


class Strength(Reply, frozen=True, kw_only=True):
    """Bradley-Terry: log strength with its 95 % interval, mean of all systems 0."""

    system: str
    group: str
    question: Question
    category: Category | Literal["all"]
    strength: float
    low: float
    high: float
    rank: int


class Agreement(Reply, frozen=True, kw_only=True):
    """Krippendorff's alpha; null where it is not defined."""

    question: str
    metric: Literal["ordinal", "interval", "nominal"]
    alpha: float | None
    units: int
    raters: int


class PreferenceRow(Reply, frozen=True, kw_only=True):
    """One sound of a preference study."""

    sound: str
    category: Category
    votes: int
    skips: int
    chosen: Annotated[int | None, Meta(description="candidate; null: no pair")]
    rejected: int | None
    agreement: float
    margin: float
    is_kept: bool


class Results(Reply, frozen=True, kw_only=True):
    """All results of a study so far."""

    kind: Kind
    judgements: int
    raters: int
    excluded: int
    rows: tuple[ResultRow, ...]
    pairs: tuple[PairRow, ...]
    ranking: tuple[Strength, ...]
    agreement: tuple[Agreement, ...]
    preferences: tuple[PreferenceRow, ...]
    plots: Annotated[tuple[str, ...], Meta(description="names for `export/NAME`, image/svg+xml")]
    exports: Annotated[tuple[str, ...], Meta(description="names for `export/NAME`, files")]


class Event(Reply, frozen=True, kw_only=True):
    """A line of the audit."""

    id: int
    at: str
    actor: str
    action: str
    study: str
    detail: str


class Audit(Reply, frozen=True, kw_only=True):
    """Events, newest first; `before` in the query continues the list."""

    events: tuple[Event, ...]


OWNER_REQUESTS: tuple[type[Struct], ...] = (Login, NewStudy, ChangeState, Invite, Exclude)
OWNER_REPLIES: tuple[type[Struct], ...] = (
    OwnerSession,
    StudyList,
    StudyDetail,
    SetUp,
    Invited,
    Invitations,
    Raters,
    Results,
    Audit,
)
