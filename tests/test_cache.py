"""A cache that cannot be written costs time, and nothing else."""

import logging
import os
import pwd
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from echoavatar import cache
from echoavatar.cache import NOWHERE, first_writable, user_caches

UNWRITABLE = Path(os.devnull) / "folder"  # also for root


@pytest.fixture(autouse=True)
def another_machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    cache._temporary.cache_clear()
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    yield
    cache._temporary.cache_clear()


def without_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(uid: int) -> Any:
        raise KeyError(uid)

    monkeypatch.setattr(pwd, "getpwuid", unknown)


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"HOME": "/home/me"}, ["/home/me/.cache/echoavatar"]),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": "/cache"}, ["/cache/echoavatar"]),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": "cache"}, ["/home/me/.cache/echoavatar"]),
        ({"HOME": "/home/me", "XDG_CACHE_HOME": ""}, ["/home/me/.cache/echoavatar"]),
        ({"HOME": ""}, []),
        ({"HOME": "/"}, []),
        ({}, []),
    ],
)
def test_the_users_cache(variables: dict[str, str], expected: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    without_a_name(monkeypatch)
    monkeypatch.setattr("sys.platform", "linux")
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert [str(place) for place in user_caches()] == expected


def test_the_first_folder_that_can_be_written(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert (
        first_writable(Path("~/.cache/other"), UNWRITABLE, tmp_path / "a" / "b", tmp_path / "c") == tmp_path / "a" / "b"
    )
    assert (tmp_path / "a" / "b").is_dir()
    assert not list((tmp_path / "a" / "b").iterdir())
    assert not (tmp_path / "c").exists()
    assert not caplog.records


def test_without_one_a_temporary_folder_is_taken_with_one_warning(caplog: pytest.LogCaptureFixture) -> None:
    made = first_writable(UNWRITABLE)
    assert first_writable() == made
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "XDG_CACHE_HOME" in record.getMessage()
    assert made.stat().st_mode & 0o777 == 0o700, "compiled code is read from it"
    cache._temporary().cleanup()  # type: ignore[union-attr]


def test_where_nothing_can_be_written_writes_fail_and_reads_find_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(**_: Any) -> None:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", refuse)
    assert first_writable(UNWRITABLE) == first_writable() == NOWHERE
    assert len(caplog.records) == 1
    assert not (NOWHERE / "kept").exists()
    with pytest.raises(OSError, match="Not a directory"):
        NOWHERE.mkdir()
