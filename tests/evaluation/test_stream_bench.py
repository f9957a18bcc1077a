from pathlib import Path

from echoavatar.evaluation.stream_bench import bench_stream, resident_mb
from echoavatar.pipeline import Pipeline, load_bundle
from echoavatar.pipeline.pipeline import STAGES


def test_stages_add_up_to_the_chunk(tiny_bundle: Path) -> None:
    report = bench_stream(Pipeline(load_bundle(tiny_bundle)), seconds=3)
    parts = sum(report.stages_ms[stage][0] for stage in STAGES)
    assert 0.5 < parts / report.stages_ms["whole chunk"][0] < 1.5
    assert abs(report.summary["seconds"] - 3) < 0.3


def test_several_sessions_share_a_tick(tiny_bundle: Path) -> None:
    report = bench_stream(Pipeline(load_bundle(tiny_bundle)), seconds=1, sessions=3)
    assert report.summary["sessions"] == 3


def test_memory_is_in_megabytes() -> None:
    assert 50 < resident_mb() < 50_000
