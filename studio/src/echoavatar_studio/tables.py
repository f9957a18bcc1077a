"""The SQLAlchemy tables of the studio, the same on SQLite and PostgreSQL.

Times are seconds since 1970, UTC. A *trial* is a set of clips to be judged. A *block* is the sequence of trials of
one rater. A *task* is a trial at its place in a block, with the order in which its clips are shown. Personal data is
limited to a rater's number and the times of answers; tokens are stored as hashes.
"""

from typing import Any

from sqlalchemy import JSON, BigInteger, CheckConstraint, ForeignKey, Index, MetaData, String, Text, UniqueConstraint
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

_NAMES = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}


class Table(DeclarativeBase):
    """Base of all tables; constraints have names, so that migrations can change them."""

    metadata = MetaData(naming_convention=_NAMES)
    id: Mapped[int] = mapped_column(primary_key=True)


def _of(table: str, *, cascade: bool = True) -> Any:
    return mapped_column(ForeignKey(f"{table}.id", ondelete="CASCADE" if cascade else "SET NULL"), index=True)


class Owner(Table):
    """An account that may set studies up and see results."""

    __tablename__ = "owners"
    name: Mapped[str] = mapped_column(String(128), unique=True)
    password: Mapped[str] = mapped_column(String(256))  # scrypt, see `secrecy`
    created: Mapped[float]


class Study(Table):
    """A preference or pairwise study."""

    __tablename__ = "studies"
    public: Mapped[str] = mapped_column(String(32), unique=True)
    kind: Mapped[str] = mapped_column(String(16))
    title: Mapped[str] = mapped_column(String(200))
    state: Mapped[str] = mapped_column(String(16))
    settings: Mapped[str] = mapped_column(Text)  # study.yaml
    problem: Mapped[str] = mapped_column(Text, default="")
    created: Mapped[float]


class System(Table):
    """A system that is compared; a preference study has one."""

    __tablename__ = "systems"
    __table_args__ = (UniqueConstraint("study_id", "name"),)
    study_id: Mapped[int] = _of("studies")
    name: Mapped[str] = mapped_column(String(128))
    source: Mapped[str] = mapped_column(Text)
    place: Mapped[int]


class Sound(Table):
    """The sound of a trial. `prompt` of a preference study: clip, start, past (`align.preferences`)."""

    __tablename__ = "sounds"
    __table_args__ = (UniqueConstraint("study_id", "name"),)
    study_id: Mapped[int] = _of("studies")
    name: Mapped[str] = mapped_column(String(200))
    category: Mapped[str] = mapped_column(String(16))
    path: Mapped[str] = mapped_column(Text)  # relative to the media folder
    seconds: Mapped[float]
    prompt: Mapped[dict[str, Any] | None] = mapped_column(JSON)


class Clip(Table):
    """Motion to a sound. `system_id` is null for motion that was corrupted on purpose."""

    __tablename__ = "clips"
    study_id: Mapped[int] = _of("studies")
    sound_id: Mapped[int] = _of("sounds")
    system_id: Mapped[int | None] = _of("systems")
    candidate: Mapped[int] = mapped_column(default=0)
    path: Mapped[str] = mapped_column(Text)
    seed: Mapped[int | None] = mapped_column(BigInteger)
    codes: Mapped[list[Any] | None] = mapped_column(JSON)  # preference: tokens x parts x layers


class Trial(Table):
    """A set of clips to be judged. Clips by place: (a, b) if pairwise, else the candidates."""

    __tablename__ = "trials"
    study_id: Mapped[int] = _of("studies")
    sound_id: Mapped[int] = _of("sounds")
    role: Mapped[str] = mapped_column(String(16))  # real, identical, corrupted, training
    clips: Mapped[list[int]] = mapped_column(JSON)


class Invitation(Table):
    """A link: personal, or open to a number of raters."""

    __tablename__ = "invitations"
    study_id: Mapped[int] = _of("studies")
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    label: Mapped[str] = mapped_column(String(80))
    is_open: Mapped[bool]
    seats: Mapped[int]
    taken: Mapped[int] = mapped_column(default=0)
    is_revoked: Mapped[bool] = mapped_column(default=False)
    created: Mapped[float]


class Rater(Table):
    """A person who accepted an invitation: a number without a name."""

    __tablename__ = "raters"
    __table_args__ = (UniqueConstraint("study_id", "number"),)
    study_id: Mapped[int] = _of("studies")
    invitation_id: Mapped[int] = _of("invitations")
    number: Mapped[int]
    token_hash: Mapped[str | None] = mapped_column(String(64), unique=True)
    joined: Mapped[float]
    seen: Mapped[float]
    consented: Mapped[float | None]
    is_excluded: Mapped[bool] = mapped_column(default=False)
    reason: Mapped[str] = mapped_column(Text, default="")


class Block(Table):
    """The tasks of one rater, planned before the rater joins."""

    __tablename__ = "blocks"
    __table_args__ = (UniqueConstraint("study_id", "number"), UniqueConstraint("rater_id"))
    study_id: Mapped[int] = _of("studies")
    number: Mapped[int]
    rater_id: Mapped[int | None] = mapped_column(ForeignKey("raters.id", ondelete="SET NULL"))


class Task(Table):
    """A trial at its place in a block: `order[slot]` is the place of the clip shown there."""

    __tablename__ = "tasks"
    __table_args__ = (UniqueConstraint("block_id", "position"), UniqueConstraint("block_id", "trial_id"))
    public: Mapped[str] = mapped_column(String(32), unique=True)
    block_id: Mapped[int] = _of("blocks")
    trial_id: Mapped[int] = _of("trials")
    position: Mapped[int]
    order: Mapped[list[int]] = mapped_column(JSON)
    first: Mapped[int]


class Judgement(Table):
    """One answer. Ratings are towards the trial's first clip: positive if place 0 was preferred."""

    __tablename__ = "judgements"
    __table_args__ = (
        UniqueConstraint("task_id"),
        UniqueConstraint("rater_id", "key"),
        CheckConstraint("human_likeness BETWEEN -2 AND 2", name="human_likeness"),
        CheckConstraint("beat_matching BETWEEN -2 AND 2", name="beat_matching"),
        CheckConstraint("overall_preference BETWEEN -2 AND 2", name="overall_preference"),
        CheckConstraint("best IS NULL OR best <> worst", name="best_is_not_worst"),
    )
    task_id: Mapped[int] = mapped_column(ForeignKey("tasks.id", ondelete="CASCADE"))
    rater_id: Mapped[int] = _of("raters")
    key: Mapped[str] = mapped_column(String(64))
    digest: Mapped[str] = mapped_column(String(64))
    skipped: Mapped[str | None] = mapped_column(String(16))
    human_likeness: Mapped[int | None]
    beat_matching: Mapped[int | None]
    overall_preference: Mapped[int | None]
    best: Mapped[int | None]  # places in the trial
    worst: Mapped[int | None]
    seconds: Mapped[float]
    plays: Mapped[list[int]] = mapped_column(JSON)
    at: Mapped[float]


class Login(Table):
    """A session of a rater or an owner."""

    __tablename__ = "logins"
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    csrf: Mapped[str] = mapped_column(String(64))
    owner_id: Mapped[int | None] = _of("owners")
    rater_id: Mapped[int | None] = _of("raters")
    expires: Mapped[float]


class Event(Table):
    """A line of the audit: what happened, and by whom. It stays when raters and studies are deleted."""

    __tablename__ = "events"
    __table_args__ = (Index("ix_events_study_id", "study", "id"),)
    at: Mapped[float]
    actor: Mapped[str] = mapped_column(String(160))
    action: Mapped[str] = mapped_column(String(48))
    study: Mapped[str] = mapped_column(String(32), default="")
    detail: Mapped[str] = mapped_column(Text, default="")
