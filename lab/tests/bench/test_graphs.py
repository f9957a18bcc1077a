"""The bench of the live step runs plainly on a CPU."""

import pytest
import torch
from lab.tests.reference.conftest import bundle_of
from scripts.synthetic_release import make

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.bench.graphs import bench_graphs


def test_every_stage_is_timed(tmp_path):
    folder = bundle_of(make(tmp_path / "release", "small"), tmp_path / "bundle")
    report = bench_graphs(load_bundle(folder), device="cpu", chunks=3)
    assert set(report.stages_ms) == {"encoder", "generator", "decoder", "rig", "total"}
    assert all(times[0] > 0 for times in report.stages_ms.values())
    assert not report.is_captured
    assert report.chunk_ms == pytest.approx(266.7, abs=0.1)


def test_a_missing_gpu_is_an_error(tiny_bundle):
    if not torch.cuda.is_available():
        with pytest.raises(EchoAvatarError, match="--device cpu"):
            bench_graphs(load_bundle(tiny_bundle), chunks=1)


@pytest.mark.gpu
def test_the_captured_step_runs(tmp_path):
    folder = bundle_of(make(tmp_path / "release", "small"), tmp_path / "bundle")
    report = bench_graphs(load_bundle(folder), chunks=10)
    assert report.is_captured
