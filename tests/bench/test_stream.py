from pathlib import Path

import numpy as np

from echoavatar.bench.stream import bench_stream
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.pipeline import STAGES


def test_stages_add_up_to_the_chunk(tiny_bundle: Path) -> None:
    """In every chunk the stages take no longer than the whole, and most of it; so do their medians."""
    pipeline = Pipeline(load_bundle(tiny_bundle))
    report = bench_stream(pipeline, seconds=3)
    chunks = round(3 / pipeline.chunk.seconds)
    stages = [pipeline.on_stage.stages[stage][-chunks:] for stage in STAGES]
    parts, whole = np.median(np.sum(stages, axis=0)), report.stages_ms["whole chunk"][0]
    assert 0.5 * whole < parts <= whole
    assert abs(report.summary["seconds"] - 3) < 0.3


def test_several_sessions_share_a_tick(tiny_bundle: Path) -> None:
    report = bench_stream(Pipeline(load_bundle(tiny_bundle)), seconds=1, sessions=3)
    assert report.summary["sessions"] == 3
