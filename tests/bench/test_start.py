import json
from pathlib import Path

import pytest

from echoavatar.bench.start import bench_start
from echoavatar.cli import main


@pytest.mark.slow
def test_a_start_is_timed_stage_by_stage_in_fresh_processes(
    tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "start", "--model", str(tiny_bundle), "--runs", "2"]) == 0
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    parts = ("numpy_s", "imports_s", "load_s", "warm-up_s", "motion_s")
    assert all(0 < result[part] < result["animate_s"] for part in parts)


def test_one_run_shows_no_warm_start_and_a_failure_is_told(tmp_path: Path) -> None:
    assert main(["bench", "start", "--runs", "1"]) == 1
    with pytest.raises(RuntimeError, match="nowhere"):
        bench_start(str(tmp_path / "nowhere"), runs=2)
