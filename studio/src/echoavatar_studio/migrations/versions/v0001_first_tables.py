"""The first version of the tables (see `tables`); constraints and indexes get their names from its conventions."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "v0001"
down_revision = None
branch_labels = None
depends_on = None


def _table(name: str, *parts: Any) -> None:
    op.create_table(name, *parts, sa.Column("id", sa.Integer(), primary_key=True))


def _column(name: str, kind: Any, *, nullable: bool = False, **how: Any) -> sa.Column[Any]:
    return sa.Column(name, kind, nullable=nullable, **how)


def _of(name: str, table: str, *, nullable: bool = False, ondelete: str = "CASCADE", **how: Any) -> sa.Column[Any]:
    key = sa.ForeignKey(f"{table}.id", ondelete=ondelete)
    return sa.Column(name, sa.Integer(), key, nullable=nullable, **{"index": True, **how})


def upgrade() -> None:
    """Create the tables."""
    _table(
        "events",
        _column("at", sa.Double()),
        _column("actor", sa.String(160)),
        _column("action", sa.String(48)),
        _column("study", sa.String(32)),
        _column("detail", sa.Text()),
    )
    op.create_index("ix_events_study_id", "events", ["study", "id"])
    _table(
        "owners",
        _column("name", sa.String(128), unique=True),
        _column("password", sa.String(256)),
        _column("created", sa.Double()),
    )
    _table(
        "studies",
        _column("public", sa.String(32), unique=True),
        _column("kind", sa.String(16)),
        _column("title", sa.String(200)),
        _column("state", sa.String(16)),
        _column("settings", sa.Text()),
        _column("problem", sa.Text()),
        _column("created", sa.Double()),
    )
    _table(
        "invitations",
        _of("study_id", "studies"),
        _column("token_hash", sa.String(64), unique=True),
        _column("label", sa.String(80)),
        _column("is_open", sa.Boolean()),
        _column("seats", sa.Integer()),
        _column("taken", sa.Integer()),
        _column("is_revoked", sa.Boolean()),
        _column("created", sa.Double()),
    )
    _table(
        "sounds",
        _of("study_id", "studies"),
        _column("name", sa.String(200)),
        _column("category", sa.String(16)),
        _column("path", sa.Text()),
        _column("seconds", sa.Double()),
        _column("prompt", sa.JSON(), nullable=True),
        sa.UniqueConstraint("study_id", "name"),
    )
    _table(
        "systems",
        _of("study_id", "studies"),
        _column("name", sa.String(128)),
        _column("source", sa.Text()),
        _column("place", sa.Integer()),
        sa.UniqueConstraint("study_id", "name"),
    )
    _table(
        "clips",
        _of("study_id", "studies"),
        _of("sound_id", "sounds"),
        _of("system_id", "systems", nullable=True),
        _column("candidate", sa.Integer()),
        _column("path", sa.Text()),
        _column("seed", sa.BigInteger(), nullable=True),
        _column("codes", sa.JSON(), nullable=True),
    )
    _table(
        "raters",
        _of("study_id", "studies"),
        _of("invitation_id", "invitations"),
        _column("number", sa.Integer()),
        _column("token_hash", sa.String(64), nullable=True, unique=True),
        _column("joined", sa.Double()),
        _column("seen", sa.Double()),
        _column("consented", sa.Double(), nullable=True),
        _column("is_excluded", sa.Boolean()),
        _column("reason", sa.Text()),
        sa.UniqueConstraint("study_id", "number"),
    )
    _table(
        "trials",
        _of("study_id", "studies"),
        _of("sound_id", "sounds"),
        _column("role", sa.String(16)),
        _column("clips", sa.JSON()),
    )
    _table(
        "blocks",
        _of("study_id", "studies"),
        _column("number", sa.Integer()),
        _of("rater_id", "raters", nullable=True, ondelete="SET NULL", index=False, unique=True),
        sa.UniqueConstraint("study_id", "number"),
    )
    _table(
        "logins",
        _column("token_hash", sa.String(64), unique=True),
        _column("csrf", sa.String(64)),
        _of("owner_id", "owners", nullable=True),
        _of("rater_id", "raters", nullable=True),
        _column("expires", sa.Double()),
    )
    _table(
        "tasks",
        _column("public", sa.String(32), unique=True),
        _of("block_id", "blocks"),
        _of("trial_id", "trials"),
        _column("position", sa.Integer()),
        _column("order", sa.JSON()),
        _column("first", sa.Integer()),
        sa.UniqueConstraint("block_id", "position"),
        sa.UniqueConstraint("block_id", "trial_id"),
    )
    ratings = ("human_likeness", "beat_matching", "overall_preference")
    _table(
        "judgements",
        _of("task_id", "tasks", index=False, unique=True),
        _of("rater_id", "raters"),
        _column("key", sa.String(64)),
        _column("digest", sa.String(64)),
        _column("skipped", sa.String(16), nullable=True),
        *(_column(name, sa.Integer(), nullable=True) for name in (*ratings, "best", "worst")),
        _column("seconds", sa.Double()),
        _column("plays", sa.JSON()),
        _column("at", sa.Double()),
        *(sa.CheckConstraint(f"{name} BETWEEN -2 AND 2", name=name) for name in ratings),
        sa.CheckConstraint("best IS NULL OR best <> worst", name="best_is_not_worst"),
        sa.UniqueConstraint("rater_id", "key"),
    )
