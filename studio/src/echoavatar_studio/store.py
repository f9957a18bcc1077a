"""The store: SQLite (WAL) or PostgreSQL by URL, updated by migrations.

A transaction that has ended is on disk: SQLite syncs its log at each commit (`synchronous=FULL`), PostgreSQL does so by
default. SQLite has one write lock; the writers of a process queue for it instead of polling.

A database that cannot be reached, is full, locked or read-only raises `StoreAwayError` from every transaction until it
is back; then new transactions work again.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config as AlembicConfig
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

from echoavatar.errors import EchoAvatarError

from .errors import StoreAwayError

_SQLITE_OUTAGES = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_CORRUPT,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_PROTOCOL,
    sqlite3.SQLITE_NOTADB,
}
_WAIT_S = 10  # for a lock or a connection: twice this is less than the pages wait for an answer


class Store:
    """Transactions: `read()` only reads, `write()` commits at its end or not at all."""

    def __init__(self, url: str) -> None:
        """Connect and migrate.

        Raises:
            EchoAvatarError: the address is not one of a database, or the database cannot be reached.
        """
        self.url = _checked(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        self.engine = _engine(self.url, is_sqlite=self.is_sqlite)
        self._writing = self.engine.execution_options(studio_writes=True)
        try:
            migrate(self.engine)
        except BaseException as error:
            self.engine.dispose()  # the failed migration's connection is in the pool, and nothing else closes it
            if not isinstance(error, DBAPIError):
                raise
            raise EchoAvatarError(
                f"the store {self.url.render_as_string()} cannot be opened ({error.orig}); check --store"
            ) from error
        self._lock = threading.Lock()
        self._is_closed = False
        event.listen(self.engine, "checkin", self._let_go)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A transaction that only reads.

        Raises:
            StoreAwayError: the database is away.
        """
        with _telling_outages(), Session(self.engine, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A transaction that writes; an exception rolls it back.

        Raises:
            StoreAwayError: the database is away. If it went away at the very end, the transaction may be on disk.
        """
        with (
            self._turn(),
            _telling_outages(),
            Session(self._writing, expire_on_commit=False) as session,
            session.begin(),
        ):
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[Session]:
        """A transaction that reads everything as of one moment, however long it takes.

        Raises:
            StoreAwayError: the database is away.
        """
        engine = self.engine
        if not self.is_sqlite:  # an SQLite transaction reads one moment anyway
            engine = engine.execution_options(isolation_level="REPEATABLE READ")
        with _telling_outages(), Session(engine) as session:
            yield session

    def close(self) -> None:
        """Close the connections; those of transactions that still run close at their end."""
        self._is_closed = True
        self.engine.dispose()

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self.is_sqlite:
            yield
            return
        if not self._lock.acquire(timeout=_WAIT_S):
            raise StoreAwayError("other writers take too long")
        try:
            yield
        finally:
            self._lock.release()

    def _let_go(self, connection: object, record: ConnectionPoolEntry) -> None:
        """Close a connection that comes back after `close`."""
        del connection
        if self._is_closed:
            record.invalidate()


@contextmanager
def _telling_outages() -> Iterator[None]:
    try:
        yield
    except (DBAPIError, PoolTimeout) as error:
        cause = error.orig if isinstance(error, DBAPIError) else error
        if not _is_outage(error):
            raise
        raise StoreAwayError(" ".join(str(cause).split())[:300]) from error


def _is_outage(error: DBAPIError | PoolTimeout) -> bool:
    """Whether an error is of the database's state, and not of a statement or its values."""
    if isinstance(error, PoolTimeout):
        return True
    if isinstance(error.orig, sqlite3.Error):
        return getattr(error.orig, "sqlite_errorcode", 0) & 0xFF in _SQLITE_OUTAGES
    is_read_only = getattr(error.orig, "sqlstate", None) == "25006"
    return isinstance(error, OperationalError) or error.connection_invalidated or is_read_only


def sqlite_url(path: Path) -> str:
    """The URL of an SQLite file."""
    return URL.create("sqlite", database=str(path)).render_as_string()


def migrate(engine: Engine) -> None:
    """Update the tables. Two studios that start at the same time wait for each other."""
    with engine.execution_options(studio_writes=True).begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.exec_driver_sql("SELECT pg_advisory_xact_lock(727274)")
        config = AlembicConfig()
        config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def _checked(url: str) -> URL:
    try:
        parsed = make_url(url)
        name = parsed.get_backend_name()
    except (ArgumentError, NoSuchModuleError) as error:
        raise EchoAvatarError(
            f"{url[:80]!r} is not the address of a database; use sqlite:///file.db or postgresql://user@host/name"
        ) from error
    if name == "postgresql" and "+" not in parsed.drivername:
        parsed = parsed.set(drivername="postgresql+psycopg")
    elif name not in ("sqlite", "postgresql"):
        raise EchoAvatarError(f"the studio keeps its data in SQLite or PostgreSQL, not in {name}; change --store")
    return parsed


def _engine(url: URL, *, is_sqlite: bool) -> Engine:
    if not is_sqlite:
        url = url.update_query_dict({"connect_timeout": str(_WAIT_S)} | dict(url.query))
        return create_engine(
            url, pool_size=20, max_overflow=30, pool_timeout=_WAIT_S, pool_pre_ping=True, hide_parameters=True
        )
    if not url.database or url.database == ":memory:":
        raise EchoAvatarError("a store in memory would lose every judgement; name a file: sqlite:///studio.db")
    try:
        Path(url.database).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchoAvatarError(f"the store cannot be in {url.database} ({error.strerror}); choose another") from error
    engine = create_engine(url, pool_size=20, max_overflow=30, pool_timeout=_WAIT_S, hide_parameters=True)
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: sqlite3.Connection, record: ConnectionPoolEntry) -> None:
    del record
    connection.isolation_level = None  # transactions are begun below, not by the driver
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={round(1000 * _WAIT_S)}"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    """Writers take the write lock when they begin: SQLite does not wait for a lock in the middle of a transaction."""
    options: dict[str, Any] = dict(connection.get_execution_options())
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("studio_writes") else "BEGIN")
