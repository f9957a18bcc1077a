"""A small download of random numbers, made once, and what becomes of it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from scripts.synthetic_release import make

from echoavatar.timing import ChunkSize
from echoavatar_lab.models.published import read_encodec
from echoavatar_lab.reference import Release, convert, inspect_release
from echoavatar_lab.reference.actions import find_table, library, read_table


@pytest.fixture(scope="session")
def download(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("download"), "small")


@pytest.fixture
def spoilt(download: Path, tmp_path: Path) -> Callable[[str], Path]:
    """A copy whose named file may be written; everything else is linked."""

    def copy(pattern: str) -> Path:
        shutil.copytree(download, tmp_path / "download", copy_function=lambda a, b: Path(b).hardlink_to(a))
        path = next((tmp_path / "download").glob(pattern))
        if path.is_file():
            data = path.read_bytes()
            path.unlink()
            path.write_bytes(data)
        return path

    return copy


def bundle_of(download: Path, output: Path, step: int = 2) -> Path:
    release = Release(download / "ckpts", download / "stats")
    table = find_table(release.stats)
    assert table is not None
    actions = library(read_table(table), 512, origin=str(table), chunk=ChunkSize(step))
    codec = read_encodec(download / "encodec")
    convert(inspect_release(release, step=step), codec, output, actions=actions)
    return output


@pytest.fixture(scope="session")
def imported(download: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bundle_of(download, tmp_path_factory.mktemp("imported"))


@pytest.fixture(scope="session")
def in_threes(download: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same download with the release's own step: three motion tokens, 12 frames, 9,600 samples."""
    return bundle_of(download, tmp_path_factory.mktemp("in_threes"), step=3)
