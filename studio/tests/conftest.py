"""Studios to test: on SQLite, and on a real PostgreSQL where Debian's package is installed."""

import os
import pwd
import shutil
import subprocess
import tempfile
import uuid
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import psycopg
import pytest
from studio.tests import canned
from tests.conftest import certified, tiny_bundle, voice  # noqa: F401

from echoavatar_studio import secrecy
from echoavatar_studio.making import Maker
from echoavatar_studio.store import Store, sqlite_url

PROGRAMS = [Path(path).parent for path in (shutil.which("initdb"),) if path] + sorted(
    Path("/usr/lib/postgresql").glob("*/bin"), reverse=True
)
STORES = ("sqlite", "postgresql")


@pytest.fixture(autouse=True)
def _cheap_hashes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Passwords are hashed at little cost, except where the hash itself is tested: each takes 0.3 s."""
    if request.path.stem != "test_secrecy":
        monkeypatch.setattr(secrecy, "_COST", {"n": 2, "r": 1, "p": 1})


class Cluster:
    """A PostgreSQL server of our own, on a socket in a temporary folder."""

    def __init__(self, programs: Path) -> None:
        self._programs = programs
        self.folder = Path(tempfile.mkdtemp(prefix="studio-pg-"))  # short: a socket's path has 107 bytes at most
        self.address = f"postgresql://studio@/{{name}}?host={self.folder}"
        self._who: dict[str, object] = {}
        if os.geteuid() == 0:  # the server refuses to run as root
            known = {entry.pw_name for entry in pwd.getpwall()}
            account = pwd.getpwnam(next(name for name in ("postgres", "nobody") if name in known))
            os.chown(self.folder, account.pw_uid, account.pw_gid)
            self._who = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}
        self._run("initdb", "-U", "studio", "-A", "trust", "--no-sync", "-E", "UTF8")

    def start(self) -> None:
        options = f"-c listen_addresses='' -c unix_socket_directories={self.folder} -c max_connections=300"
        self._run("pg_ctl", "-w", "-t", "120", "-l", str(self.folder / "log"), "-o", options, "start")

    def stop(self) -> None:
        """As a crash would: connections are cut, nothing is tidied up."""
        self._run("pg_ctl", "-m", "immediate", "stop")

    def _run(self, program: str, *words: str) -> None:
        done = subprocess.run(
            [self._programs / program, "-D", str(self.folder / "data"), *words],
            cwd=self.folder,
            capture_output=True,
            text=True,
            env={"LC_ALL": "C"},
            **self._who,
        )
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="session")
def cluster() -> Iterator[Cluster]:
    """A PostgreSQL server that runs; a test that stops it starts it again."""
    programs = next((folder for folder in PROGRAMS if (folder / "initdb").exists()), None)
    if programs is None:
        pytest.skip("PostgreSQL is not installed (Debian: apt install postgresql)")
    made = Cluster(programs)
    made.start()
    try:
        yield made
    finally:
        made.stop()
        shutil.rmtree(made.folder)


@pytest.fixture(scope="session")
def postgres(cluster: Cluster) -> str:
    """The address of a PostgreSQL server, with a place for the name of the database."""
    return cluster.address


def fresh_database(postgres: str) -> str:
    """The address of a new, empty database."""
    return _database(postgres, "template1")


def ready_database(postgres: str) -> str:
    """The address of a new database that has all tables: copying one is quicker than making them."""
    return _database(postgres, _migrated(postgres))


def _database(postgres: str, like: str) -> str:
    name = f"studio_{uuid.uuid4().hex}"
    with psycopg.connect(postgres.format(name="postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {like}")
    return postgres.format(name=name)


@lru_cache(maxsize=1)
def _migrated(postgres: str) -> str:
    url = fresh_database(postgres)
    Store(url).close()
    return url.split("@/")[1].split("?")[0]


def store_of(request: pytest.FixtureRequest) -> str | None:
    """For a fixture whose parameters are `STORES`: a new store's address, None for SQLite in the studio's folder."""
    return ready_database(request.getfixturevalue("postgres")) if request.param == "postgresql" else None


@pytest.fixture(params=STORES)
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An address of both kinds where nothing is yet."""
    if request.param == "sqlite":
        return sqlite_url(tmp_path / "studio.db")
    return fresh_database(request.getfixturevalue("postgres"))


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sounds of each kind, and clips of three systems."""
    folder = tmp_path_factory.mktemp("library")
    canned.library(folder)
    return folder


@pytest.fixture
def maker(tmp_path: Path) -> Iterator[Maker]:
    """An empty studio on SQLite."""
    made = canned.studio(tmp_path / "studio")
    yield made
    made.store.close()


@pytest.fixture(params=STORES)
def either(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Maker]:
    """An empty studio on either kind of store."""
    made = canned.studio(tmp_path / "studio", store_of(request))
    yield made
    made.store.close()
