"""The store goes away and comes back: 503 with a time to wait, a line a minute, and each answer is kept once."""

import logging
import resource
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Connection, event
from studio.tests import canned
from studio.tests.conftest import Cluster, ready_database
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens

from echoavatar_studio import making, store
from echoavatar_studio.making import Maker
from echoavatar_studio.settings import parse_study
from echoavatar_studio.tables import Judgement, Study

Outage = Callable[[Maker], Any]


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_WAIT_S", 0.05)
    monkeypatch.setattr(making, "RETRY_S", 0.01)


def path_of(maker: Maker) -> Path:
    return Path(str(maker.store.url.database))


@contextmanager
def locked(maker: Maker) -> Iterator[None]:
    """Another process holds the write lock."""
    other = sqlite3.connect(path_of(maker), isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    yield
    other.close()


@contextmanager
def read_only(maker: Maker) -> Iterator[None]:
    """SQLite's own error for a file system that cannot be written."""

    def begin(connection: Connection) -> None:
        connection.exec_driver_sql(f"PRAGMA query_only={int(is_away)}")

    is_away = True
    event.listen(maker.store.engine, "begin", begin)
    yield
    is_away = False


@contextmanager
def full(maker: Maker) -> Iterator[None]:
    """No file of this process may grow."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def gone(maker: Maker) -> Iterator[None]:
    """The folder cannot be opened any more, and no connection is left."""
    folder = path_of(maker).parent
    maker.store.engine.dispose()
    folder.rename(folder.with_name("elsewhere"))
    yield
    folder.with_name("elsewhere").rename(folder)


@pytest.mark.parametrize("outage", [locked, read_only, full, gone])
def test_an_answer_in_an_outage_is_told_to_wait_and_kept_once(maker: Maker, library, caplog, outage: Outage):
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    task = rater.task()
    with outage(maker), caplog.at_level(logging.INFO):
        for _ in range(5):
            refused = rater.answer(task, key="key-12345")
            assert refused.status_code == 503, refused.text
            assert int(refused.headers["retry-after"]) >= 1
            assert refused.json()["code"] == "busy", "the built pages repeat what is busy"
            assert "Traceback" not in refused.text
        forged = rater.post("/api/rater/leave", origin="https://evil.example")
        assert forged.status_code == 503, "a refusal whose line in the audit cannot be written"
    told = [record for record in caplog.records if record.name.startswith("echoavatar_studio")]
    assert len(told) == 1
    assert told[0].exc_info is None
    assert rater.answer(task, key="key-12345").json()["is_repeated"] is False
    assert rater.answer(task, key="key-12345").json()["is_repeated"] is True
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 1


def test_a_file_of_a_task_that_cannot_be_read_is_waited_for(maker: Maker, library):
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    task = rater.task()
    maker.media.rename(maker.media.with_name("elsewhere"))
    assert rater.get(task["audio"]).status_code == 503
    maker.media.with_name("elsewhere").rename(maker.media)
    assert rater.get(task["audio"]).status_code == 200


def test_writers_that_queue_behind_a_slow_one_are_told_to_wait(maker: Maker):
    owner = OwnerPerson(app_of(maker))
    with maker.store.write():
        assert owner.log_in().status_code == 503
    assert owner.log_in().status_code == 200


def test_a_statement_that_is_wrong_is_no_outage(maker: Maker):
    owner = OwnerPerson(app_of(maker))
    owner.log_in()
    with maker.store.write() as session:
        session.connection().exec_driver_sql("ALTER TABLE studies RENAME TO other")
    assert owner.get("/api/owner/studies").json()["code"] == "internal"


def test_a_study_that_was_made_in_an_outage_opens_after_it(maker: Maker, library):
    settings = parse_study(canned.pairwise_text())
    public = maker.begin(settings, by="test")
    with locked(maker):
        thread = maker.make_later(public, settings, library)
        thread.join(0.5)
        assert thread.is_alive()
        assert maker.making[public].what == "planning"
    thread.join(30)
    with maker.store.read() as session:
        assert session.query(Study).one().state == "open"


@pytest.mark.slow
def test_postgresql_that_is_stopped_and_started(cluster: Cluster, tmp_path: Path, library, caplog):
    """Ten raters answer while the server crashes; every answer is repeated, as the page does, and kept once."""
    maker = canned.studio(tmp_path / "studio", ready_database(cluster.address))
    app = app_of(maker)
    study = canned.make_pairwise(maker, library, raters=10)
    raters = [RaterPerson(app).begin(token) for token in tokens(maker, study, 10)]
    cluster.stop()
    try:
        with caplog.at_level(logging.INFO):
            for rater in raters:
                refused = rater.get("/api/rater/task")
                assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
    finally:
        cluster.start()
    assert [record.exc_info for record in caplog.records if record.levelno >= logging.WARNING] == [None]
    tasks = [rater.task() for rater in raters]

    def insist(number: int) -> None:
        for _ in range(200):
            answer = raters[number].answer(tasks[number], key=f"key-{number:08d}")
            statuses.add(answer.status_code)
            if answer.status_code == 200:
                return
            time.sleep(0.05)

    statuses: set[int] = set()
    cluster.stop()
    threads = [threading.Thread(target=insist, args=(number,)) for number in range(len(raters))]
    for thread in threads:
        thread.start()
    cluster.start()
    for thread in threads:
        thread.join()
    assert statuses == {200, 503}
    with maker.store.read() as session:
        assert session.query(Judgement).count() == len(raters)
    maker.store.close()
