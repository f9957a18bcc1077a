"""A backup put back is the same studio: also from one kind of store into the other, also taken while raters answer."""

import errno
import json
import os
import shutil
import threading
import zipfile
from pathlib import Path

import pytest
from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of, tokens

from echoavatar.errors import EchoAvatarError
from echoavatar_studio.backup import back_up, restore
from echoavatar_studio.making import Maker
from echoavatar_studio.results import results
from echoavatar_studio.tables import Judgement


def filled(maker: Maker, library) -> tuple[str, str]:
    """A study with one rater in mid-study; its name and the rater's link."""
    study = canned.make_pairwise(maker, library)
    token = tokens(maker, study, 1)[0]
    rater = RaterPerson(app_of(maker)).begin(token)
    for _ in range(4):
        rater.answer(rater.task())
    return study, token


def test_a_studio_comes_back_and_goes_on(either: Maker, library, url: str, tmp_path):
    """From SQLite and from PostgreSQL, into SQLite and into PostgreSQL."""
    study, token = filled(either, library)
    told = back_up(either.store, either.media, tmp_path / "b.zip")
    assert told["judgements"] == 4
    assert told["files"] == 4 * 5  # a sound, three clips and a corrupted one each
    other = Maker(canned.open_store(tmp_path / "other", url), tmp_path / "other" / "media")
    assert restore(other.store, other.media, tmp_path / "b.zip") == told
    assert results(other.store, study) == results(either.store, study)
    app = app_of(other)
    rater = RaterPerson(app)
    assert rater.join(token).json()["progress"]["done"] == 4  # the old link, the old place
    task = rater.task()
    assert rater.get(task["clips"][0]).status_code == 200
    assert rater.answer(task).status_code == 200
    assert OwnerPerson(app).log_in().status_code == 200
    with pytest.raises(EchoAvatarError, match="not empty"):
        restore(other.store, other.media, tmp_path / "b.zip")
    other.store.close()


def test_backups_are_taken_while_raters_answer(maker: Maker, library, tmp_path):
    study = canned.make_pairwise(maker, library, raters=2)
    one, two = (RaterPerson(app_of(maker)).begin(token) for token in tokens(maker, study, 2))
    one.answer(one.task())

    def work() -> None:
        while (task := two.task()) is not None:
            two.answer(task)

    working = threading.Thread(target=work)
    working.start()
    counts = [back_up(maker.store, maker.media, tmp_path / f"{k}.zip")["judgements"] for k in range(3)]
    working.join()
    assert counts == sorted(counts)
    with maker.store.read() as session:
        assert session.query(Judgement).count() == 10 >= counts[-1]


def test_files_that_are_no_backups_are_refused(maker: Maker, tmp_path):
    (tmp_path / "a.zip").write_bytes(b"no zip")
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as whole:
        whole.writestr("rows.jsonl", '{"format": "another"}\n')
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as whole:
        whole.writestr("rows.jsonl", '{"format": "echoavatar studio 1"}\n')
        whole.writestr("media/../../escaped", "x")
    with maker.store.write() as session:
        session.execute(canned.Owner.__table__.delete())
    for name, message in (
        ("a", "not a backup"),
        ("b", "another version"),
        ("c", "not a backup"),
        ("none", "not a backup"),
    ):
        with pytest.raises(EchoAvatarError, match=message):
            restore(maker.store, maker.media, tmp_path / f"{name}.zip")
    assert not (tmp_path / "escaped").exists()
    with pytest.raises(EchoAvatarError, match="cannot write"):
        back_up(maker.store, maker.media, tmp_path / "none" / "b.zip")


def forged(source: Path, target: Path, change) -> None:
    """A backup whose rows went through `change(table, row)`."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        head, *lines = old.read("rows.jsonl").splitlines()
        rows = [json.loads(line) for line in lines]
        for stored in rows:
            change(stored["table"], stored["row"])
        new.writestr("rows.jsonl", b"\n".join([head, *(json.dumps(row).encode() for row in rows)]))
        for name in old.namelist():
            if name != "rows.jsonl":
                new.writestr(name, old.read(name))


def name_study(name: str):
    return lambda table, row: row.update(public=name) if table == "studies" else None


def point_to(path: str, tables: tuple[str, ...] = ("clips", "sounds")):
    return lambda table, row: row.update(path=path) if table in tables else None


FORGERIES = [
    *(name_study(name) for name in ("..", ".", "", "/", "../..", "a/b", "A" * 24, 7, None)),
    *(point_to(path) for path in ("../studio.db", "/etc/passwd", "", "..", "a\0b")),
    lambda table, row: row.update(nothing_of_ours=1),
    lambda table, row: row.update(id="x"),
    lambda table, row: row.clear(),
    lambda table, row: row.update(id={"a": [1]}),
]


@pytest.mark.parametrize("change", FORGERIES, ids=range(len(FORGERIES)))
def test_a_forged_backup_is_refused_whole(maker: Maker, library, tmp_path, change):
    filled(maker, library)
    back_up(maker.store, maker.media, tmp_path / "good.zip")
    forged(tmp_path / "good.zip", tmp_path / "bad.zip", change)
    other = Maker(canned.open_store(tmp_path / "other", None), tmp_path / "other" / "media")
    with pytest.raises(EchoAvatarError, match="not a backup"):
        restore(other.store, other.media, tmp_path / "bad.zip")
    with other.store.read() as session:
        assert session.query(Judgement).count() == 0
    assert list(other.media.iterdir()) == []
    other.store.close()


def test_a_backup_that_unpacks_to_more_than_it_holds_is_refused(maker: Maker, library, tmp_path):
    """Two megabytes of deflated zeros would become two gigabytes; backups store their media as they are."""
    filled(maker, library)
    back_up(maker.store, maker.media, tmp_path / "bomb.zip")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "a", zipfile.ZIP_DEFLATED) as whole:
        whole.writestr("media/" + "0" * 24 + "/000.flac", bytes(64 << 20))
    other = Maker(canned.open_store(tmp_path / "other", None), tmp_path / "other" / "media")
    with pytest.raises(EchoAvatarError, match="not a backup"):
        restore(other.store, other.media, tmp_path / "bomb.zip")
    assert list(other.media.rglob("*")) == []
    other.store.close()


def test_rows_that_never_end_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as whole:
        whole.writestr("rows.jsonl", b'{"format": "echoavatar studio 1"}\n' + b" " * (200 << 20))
    store = canned.open_store(tmp_path / "other", None)
    with pytest.raises(EchoAvatarError, match="not a backup"):
        restore(store, tmp_path / "other" / "media", tmp_path / "bomb.zip")
    store.close()


def test_a_backup_that_does_not_fit_on_the_disk_is_refused_before_anything_is_written(
    maker: Maker, library, tmp_path, monkeypatch
):
    filled(maker, library)
    back_up(maker.store, maker.media, tmp_path / "good.zip")
    other = Maker(canned.open_store(tmp_path / "other", None), tmp_path / "other" / "media")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1_000, 900, 100))
    with pytest.raises(EchoAvatarError, match="free"):
        restore(other.store, other.media, tmp_path / "good.zip")
    with other.store.read() as session:
        assert session.query(Judgement).count() == 0
    other.store.close()


def test_a_disk_that_fails_in_the_middle_leaves_neither_rows_nor_media(maker: Maker, library, tmp_path, monkeypatch):
    filled(maker, library)
    back_up(maker.store, maker.media, tmp_path / "good.zip")
    other = Maker(canned.open_store(tmp_path / "other", None), tmp_path / "other" / "media")
    copied, copy = [], shutil.copyfileobj

    def fail(source, target):
        copied.append(target.name)
        if len(copied) == 3:
            target.write(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        copy(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "copyfileobj", fail)
        with pytest.raises(EchoAvatarError, match="No space left"):
            restore(other.store, other.media, tmp_path / "good.zip")
    assert len(copied) == 3
    assert list(other.media.iterdir()) == []
    assert restore(other.store, other.media, tmp_path / "good.zip")["judgements"] == 4
    other.store.close()


def test_a_pipe_and_rows_of_gigabytes_are_refused_unread(tmp_path):
    os.mkfifo(tmp_path / "pipe.zip")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as whole:
        whole.writestr("rows.jsonl", bytes(70 << 20))
    store = canned.open_store(tmp_path / "new", None)
    for name, said in (("pipe.zip", "not a regular file"), ("bomb.zip", "bytes of rows, more than are read")):
        with pytest.raises(EchoAvatarError, match=said):
            restore(store, tmp_path / "new" / "media", tmp_path / name)
    store.close()
