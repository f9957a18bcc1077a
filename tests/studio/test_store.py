"""The store: transactions that hold, addresses that are refused, kill -9 amid a thousand submissions."""

import http.client
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import inspect, text
from tests.studio import canned
from tests.studio.people import tokens

from echoavatar.errors import EchoAvatarError
from echoavatar.studio.joining import agree, join
from echoavatar.studio.sessions import find_visitor
from echoavatar.studio.store import Store, migrate, sqlite_url
from echoavatar.studio.tables import Block, Judgement, Owner, Table, Task

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
        ("no address", "no address of a database"),
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
def test_kill_9_under_a_thousand_submissions_loses_nothing_and_doubles_nothing(url: str, tmp_path):
    """Fifty raters submit twenty answers each, all at once; the server is killed after some were acknowledged.

    What was acknowledged is in the store; after a restart every submission is sent again with its key, and in the end
    each task has its one answer.
    """
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
        posts += [(cookie, joined.csrf, public, f"key-{public}") for (public,) in tasks]
    assert len(posts) == 1000
    saved: set[str] = set()
    enough = threading.Event()
    port = Server(folder, url)
    submitting = threading.Thread(target=submit_all, args=(port.number, posts, saved, enough))
    submitting.start()
    assert enough.wait(120)
    os.kill(port.process.pid, signal.SIGKILL)
    port.process.wait()
    submitting.join()
    acknowledged = set(saved)
    assert 200 <= len(acknowledged) < 1000
    with maker.store.read() as session:
        kept = [public for (public,) in session.query(Task.public).join(Judgement)]
    assert len(kept) == len(set(kept))
    assert acknowledged <= set(kept)
    port = Server(folder, url)
    try:
        repeated = submit_all(port.number, posts, saved, threading.Event())
    finally:
        port.process.kill()
        port.process.wait()
    assert len(saved) == 1000
    assert repeated == len(kept)  # what was on disk, acknowledged or not, is known by its key
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 1000
    maker.store.close()
    logging.getLogger(__name__).warning(
        "%d acknowledged, %d on disk when killed", len(acknowledged), len(kept)
    )


class Server:
    """The studio in a process of its own."""

    def __init__(self, folder: Path, url: str) -> None:
        words = ["-m", "tests.studio.canned", "--folder", str(folder), "--store", url, "--port", "0"]
        self.process = subprocess.Popen(
            [sys.executable, *words],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": f"{ROOT / 'src'}:{ROOT}"},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.match(r"http://127.0.0.1:(\d+)/", line)
        assert found, line
        self.number = int(found[1])
        threading.Thread(target=self.process.stdout.read, daemon=True).start()


def submit_all(port: int, posts: list, saved: set[str], enough: threading.Event) -> int:
    """Sixty-four lines at a time; what was acknowledged goes into `saved`. Returns how many were known already."""
    ratings = {"human_likeness": 1, "beat_matching": 0, "overall_preference": -1}
    body = json.dumps({"type": "pairwise", "ratings": ratings, "seconds": 2, "plays": [1, 1]})
    repeated = 0
    lock = threading.Lock()

    def one(post: tuple[str, str, str, str]) -> None:
        nonlocal repeated
        cookie, csrf, public, key = post
        headers = {
            "cookie": f"studio_rater={cookie}", "x-csrf-token": csrf, "idempotency-key": key,
            "content-type": "application/json",
        }  # fmt: skip
        line = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        try:
            line.request("POST", f"/api/rater/tasks/{public}/answer", body, headers)
            answer = line.getresponse()
            told = json.loads(answer.read())
            assert answer.status == 200, told
        except (OSError, http.client.HTTPException):
            return  # the server was killed: nothing was acknowledged
        finally:
            line.close()
        with lock:
            saved.add(public)
            repeated += told["is_repeated"]
            if len(saved) >= 200:
                enough.set()

    with ThreadPoolExecutor(64) as pool:
        list(pool.map(one, posts))
    return repeated
