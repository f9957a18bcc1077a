"""The bench of captured steps runs plainly on a CPU, and says what it cannot do."""

import pytest
import torch
from scripts.synthetic_release import make
from tests.reference.conftest import bundle_of

from echoavatar.cli import main
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.evaluation.graph_bench import bench_graphs
from echoavatar.pipeline import load_bundle


def test_every_stage_is_timed(tmp_path, capsys):
    folder = bundle_of(make(tmp_path / "release", "small"), tmp_path / "bundle")
    report = bench_graphs(load_bundle(folder), device="cpu", chunks=3)
    assert set(report.stages_ms) == {"encoder", "generator", "decoder", "rig", "total"}
    parts = sum(report.stages_ms[stage][0] for stage in ("encoder", "generator", "decoder", "rig"))
    assert parts <= 1.5 * report.stages_ms["total"][0]
    assert not report.is_captured
    assert report.chunk_ms == pytest.approx(266.7, abs=0.1)
    assert main(["bench", "graphs", "--model", str(folder), "--device", "cpu", "--chunks", "2"]) == 0
    assert "not captured" in capsys.readouterr().out


def test_what_it_cannot_time_is_said(tiny_bundle):
    with pytest.raises(CheckpointError, match="no imported bundle"):
        bench_graphs(load_bundle(tiny_bundle), device="cpu", chunks=1)
    if not torch.cuda.is_available():
        with pytest.raises(EchoAvatarError, match="--device cpu"):
            bench_graphs(load_bundle(tiny_bundle), chunks=1)


@pytest.mark.gpu
def test_captured_stages_run(tmp_path):
    folder = bundle_of(make(tmp_path / "release", "small"), tmp_path / "bundle")
    report = bench_graphs(load_bundle(folder), chunks=10)
    assert report.is_captured
