"""Fixtures that several rooms share, and the loop that runs coroutine tests."""

import asyncio
import inspect
import logging
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.tiny_bundle import write_bundle

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar.wire.sockets import RepeatFilter


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine on a loop of its own, for a minute at most."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    given = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    asyncio.run(asyncio.wait_for(pyfuncitem.obj(**given), 60))
    return True


@pytest.fixture(autouse=True)
def _every_line_is_logged() -> Iterator[None]:
    """A server of one test must not drop the lines of the next as repeated ones."""
    yield
    for log in logging.root.manager.loggerDict.values():
        if isinstance(log, logging.Logger):
            log.filters = [known for known in log.filters if not isinstance(known, RepeatFilter)]


@pytest.fixture
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder instead of the user's cache."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


@pytest.fixture(scope="session")
def tiny_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of random weights, small enough to run in milliseconds."""
    return write_bundle(tmp_path_factory.mktemp("bundle"))


@pytest.fixture(scope="session")
def certified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate of 127.0.0.1 that signs itself, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl")
    folder = tmp_path_factory.mktemp("tls")
    made = "req -x509 -newkey rsa:2048 -nodes -keyout key.pem -out cert.pem -days 2 -subj /CN=localhost"
    words = ["openssl", *made.split(), "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run(words, cwd=folder, check=True, capture_output=True)
    return folder / "cert.pem", folder / "key.pem"


@pytest.fixture(scope="session")
def voice() -> np.ndarray:
    """Two seconds of something with onsets, 24 kHz mono."""
    time = np.arange(48_000) / 24_000
    return (0.3 * np.sin(2 * np.pi * 180 * time) * (np.sin(2 * np.pi * 2 * time) > 0)).astype(np.float32)


@pytest.fixture(scope="session")
def swaying() -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrices (96, 52, 3, 3) and root (96, 3) of a body that sways with planted feet."""
    turns = np.zeros((96, HUMANOID.joints, 3), np.float32)
    turns[:, HUMANOID.index("spine"), 2] = 0.2 * np.sin(np.arange(96) / 9)
    return matrix_from_axis_angle(turns), np.tile(HUMANOID.offsets[:1], (96, 1))
