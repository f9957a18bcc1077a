"""The store: transactions that hold, addresses that are refused, kill -9 amid a thousand submissions."""

import asyncio
import json
import logging
import os
import re
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from alembic.util import CommandError
from sqlalchemy import Engine, event, inspect, text
from studio.tests import canned
from studio.tests.people import tokens

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.sockets import raise_file_limit
from echoavatar_studio.joining import agree, join
from echoavatar_studio.sessions import find_visitor
from echoavatar_studio.store import Store, migrate, sqlite_url
from echoavatar_studio.tables import Block, Judgement, Owner, Table, Task

ROOT = Path(__file__).parents[2]


def test_both_kinds_have_all_tables_and_migrating_again_changes_nothing(url: str):
    store = Store(url)
    names = set(inspect(store.engine).get_table_names())
    assert set(Table.metadata.tables) < names
    migrate(store.engine)
    with store.read() as session:
        assert session.execute(text("SELECT version_num FROM alembic_version")).scalar() == "v0001"
    store.close()


def test_a_transaction_that_fails_leaves_nothing(url: str):
    store = Store(url)

    def undone() -> None:
        with store.write() as session:
            session.add(Owner(name="ghost", password="", created=0.0))
            session.flush()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        undone()
    with store.read() as session:
        assert session.query(Owner).count() == 0
    store.close()


def test_a_snapshot_sees_one_moment(url: str):
    store = Store(url)
    with store.snapshot() as early:
        assert early.query(Owner).count() == 0
        with store.write() as session:
            session.add(Owner(name="later", password="", created=0.0))
        assert early.query(Owner).count() == 0
    store.close()


def test_a_transaction_that_outlives_the_store_ends_and_closes_its_connection(url: str):
    store = Store(url)
    with store.write() as session:
        raw = session.connection().connection.dbapi_connection
        session.add(Owner(name="late", password="", created=0.0))
        store.close()
    if store.is_sqlite:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            raw.execute("SELECT 1")
    else:
        assert raw.closed
    again = Store(url)
    with again.read() as session:
        assert session.query(Owner).count() == 1
    again.close()


def test_a_store_that_cannot_be_migrated_leaves_no_connection_open(url: str):
    store = Store(url)
    with store.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = 'of the future'"))
    store.close()
    opened: list[Any] = []

    def note(raw: object, record: object) -> None:
        opened.append(raw)

    event.listen(Engine, "connect", note)
    try:
        with pytest.raises(CommandError, match="of the future"):
            Store(url)
    finally:
        event.remove(Engine, "connect", note)
    for raw in opened:
        if store.is_sqlite:
            with pytest.raises(sqlite3.ProgrammingError, match="closed"):
                raw.execute("SELECT 1")
        else:
            assert raw.closed
    assert opened


def test_sqlite_syncs_at_every_commit(tmp_path):
    store = Store(sqlite_url(tmp_path / "a.db"))
    with store.read() as session:
        assert session.execute(text("PRAGMA synchronous")).scalar() == 2  # FULL
        assert session.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert session.execute(text("PRAGMA foreign_keys")).scalar() == 1
    store.close()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("no address", "not the address of a database"),
        ("mysql://x/y", "SQLite or PostgreSQL"),
        ("sqlite://", "would lose every judgement"),
        ("sqlite:////proc/none/a.db", "cannot"),
        ("postgresql://nobody@localhost:1/none?connect_timeout=2", "cannot be opened"),
    ],
)
def test_stores_that_cannot_be_are_refused(url, message):
    with pytest.raises(EchoAvatarError, match=message):
        Store(url)


def test_passwords_of_the_database_are_not_told():
    with pytest.raises(EchoAvatarError) as told:
        Store("postgresql://me:secret@localhost:1/none?connect_timeout=2")
    assert "secret" not in str(told.value)


@pytest.mark.slow
def test_kill_9_amid_a_thousand_submissions_loses_nothing_and_doubles_nothing(url: str, tmp_path):
    """Fifty raters submit twenty answers each, all thousand under way at once; the server is killed after 200.

    What was acknowledged is in the store; after a restart every submission is sent again with its key, again all at
    once, and in the end each task has its one answer.
    """
    raise_file_limit()
    folder = tmp_path / "studio"
    maker = canned.studio(folder, url)
    canned.library(folder / "library", sounds=8)
    shape = {"raters": 50, "tasks_per_rater": 18, "training": 0, "checks": {"identical": 1, "corrupted": 1}}
    study = canned.make_pairwise(maker, folder / "library", **shape)
    posts = []
    for token in tokens(maker, study, 50):
        cookie, joined = join(maker.store, token, None, page="")
        visitor = find_visitor(maker.store, cookie)
        assert visitor is not None
        agree(maker.store, visitor)
        with maker.store.read() as session:
            tasks = session.query(Task.public).join(Block).filter(Block.rater_id == visitor.rater_id).all()
        posts += [Post(cookie, joined.csrf, public) for (public,) in tasks]
    assert len(posts) == 1000
    with Server(folder, url) as server:
        first = Sweep(posts, on_enough=server.kill)
        asyncio.run(first.submit(server.port))
    assert first.under_way == 1000
    assert 200 <= len(first.told) < 1000
    kept = answered(maker.store)
    assert len(kept) == len(set(kept))
    assert set(first.told) <= set(kept)
    with Server(folder, url) as server:
        second = Sweep(posts)
        asyncio.run(second.submit(server.port))
    assert len(second.told) == second.under_way == 1000
    known = {public for public, is_repeated in second.told.items() if is_repeated}
    assert set(kept) <= known  # what was on disk, acknowledged or not, is known by its key
    assert not maker.store.is_sqlite or set(kept) == known  # PostgreSQL may end a commit after the studio has died
    assert sorted(answered(maker.store)) == sorted(post.public for post in posts)
    maker.store.close()
    logging.getLogger(__name__).warning(
        "%d under way at once, %d acknowledged and %d on disk when killed", first.under_way, len(first.told), len(kept)
    )


def answered(store: Store) -> list[str]:
    """The task of every judgement."""
    with store.read() as session:
        return [public for (public,) in session.query(Task.public).join(Judgement)]


class Server:
    """The studio in a process of its own."""

    def __init__(self, folder: Path, url: str) -> None:
        words = ["-m", "studio.tests.canned", "--folder", str(folder), "--store", url, "--port", "0"]
        self.process = subprocess.Popen(
            [sys.executable, *words],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": f"{ROOT / 'src'}:{ROOT / 'studio/src'}:{ROOT}"},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.match(r"http://127.0.0.1:(\d+)/", line)
        assert found, line
        self.port = int(found[1])
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    def kill(self) -> None:
        os.kill(self.process.pid, signal.SIGKILL)

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self.process.wait()


class Post(NamedTuple):
    """One answer to be sent; the task's name is its key."""

    cookie: str
    csrf: str
    public: str

    def head(self, size: int) -> bytes:
        return (
            f"POST /api/rater/tasks/{self.public}/answer HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n"
            f"cookie: studio_rater={self.cookie}\r\nx-csrf-token: {self.csrf}\r\n"
            f"idempotency-key: key-{self.public}\r\ncontent-type: application/json\r\n"
            f"content-length: {size}\r\nexpect: 100-continue\r\n\r\n"
        ).encode()


class Sweep:
    """Sends all at once: no body leaves before the studio has let in every request and waits for its body."""

    def __init__(self, posts: list[Post], on_enough: Callable[[], None] = lambda: None) -> None:
        self.posts, self.told, self._on_enough = posts, dict[str, bool](), on_enough
        self.under_way = self._now = self._waiting = 0
        self._go = asyncio.Event()

    async def submit(self, port: int) -> None:
        async with asyncio.timeout(300):
            await asyncio.gather(*(self._one(port, post) for post in self.posts))

    async def _one(self, port: int, post: Post) -> None:
        ratings = {"human_likeness": 1, "beat_matching": 0, "overall_preference": -1}
        body = json.dumps({"type": "pairwise", "ratings": ratings, "seconds": 2, "plays": [1, 1]}).encode()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            writer.write(post.head(len(body)))
            assert await reader.readuntil(b"\r\n\r\n") == b"HTTP/1.1 100 Continue\r\n\r\n"
            self._waiting += 1
            if self._waiting == len(self.posts):
                self._go.set()
            await self._go.wait()
            writer.write(body)
            self._now += 1
            self.under_way = max(self.under_way, self._now)
            head, _, answer = (await reader.read()).partition(b"\r\n\r\n")
            self._now -= 1
        except OSError:
            return  # the server was killed: nothing was acknowledged
        finally:
            writer.close()
        if not answer:
            return
        assert head.startswith(b"HTTP/1.1 200"), answer
        self.told[post.public] = json.loads(answer)["is_repeated"]
        if len(self.told) == 200:
            self._on_enough()
