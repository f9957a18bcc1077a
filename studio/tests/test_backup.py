"""A backup put back is the same studio: also from one kind of store into the other, also taken while raters answer."""

import threading
import zipfile

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
