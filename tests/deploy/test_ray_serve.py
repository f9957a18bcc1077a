"""The server on Ray Serve: two replicas, one of them killed."""

import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
# Ray's workers run at niceness 15 and starve on a busy machine; its proxy is then killed after 5 s.
PATIENCE = {"RAY_worker_niceness": "0"} | {
    f"RAY_SERVE_PROXY_{check}_CHECK_TIMEOUT_S": "60" for check in ("READY", "HEALTH")
}


needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs pip install 'echoavatar[ray]'")


def drilled(*words: str, seconds: float = 300) -> Any:
    done = subprocess.run(
        [sys.executable, "tests/deploy/ray_drill.py", *words],
        cwd=ROOT,
        env=os.environ | PATIENCE | {"PYTHONPATH": f"{ROOT}:{ROOT / 'src'}", "RAY_USAGE_STATS_ENABLED": "0"},
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("{")]  # Ray prints there, too
    return json.loads(line)


@pytest.mark.slow
@needs_ray
def test_a_killed_replica_moves_its_sessions_and_nobody_hears_it() -> None:
    report = drilled()
    assert report["victim"]["moved"] == 1
    for person in (report["victim"], report["other"]):
        assert person["spoken_s"] == pytest.approx(14.0, abs=0.3)
        assert person["dry_s"] == 0.0
    if not report["same_host"]:
        assert report["other"]["moved"] == 0


@pytest.mark.slow
@needs_ray
def test_a_soak_with_a_replica_killed_every_minute_loses_no_speech() -> None:
    report = drilled("4", seconds=600)
    assert report["kills"] >= 3
    assert report["moved"] >= report["kills"]
    assert report["utterances"] > 40
    assert (report["failed"], report["cut"]) == ([], [])


def test_its_health_check_asks_what_the_server_can_say() -> None:
    """Ray is rarely installed where tests run, so the names are checked."""
    from echoavatar.server.session_manager import SessionManager

    asked = re.findall(r"_manager\.(\w+)", (ROOT / "deploy" / "ray_serve.py").read_text())
    assert asked == ["failure"]
    assert all(hasattr(SessionManager, name) for name in asked)


def test_the_extra_that_its_page_names_is_there() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = re.findall(r"echoavatar\[(\w+)\]", (ROOT / "deploy" / "ray_serve.py").read_text())
    assert named
    assert set(named) <= set(extras)
