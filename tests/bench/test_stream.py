from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echoavatar.bench.stream import StageTimer, bench_stream
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline import bundle as bundles
from echoavatar.engine.pipeline.pipeline import STAGES
from echoavatar.models.generator import GeneratorConfig, qwen_half_billion
from echoavatar.models.tokens import TokenLayout


def test_stages_add_up_to_the_chunk(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In every chunk the stages take no longer than the whole, and most of it; so do their medians."""
    timer = StageTimer()
    monkeypatch.setattr("echoavatar.bench.stream.StageTimer", lambda is_cuda: timer)
    pipeline = Pipeline(load_bundle(tiny_bundle))
    before = pipeline.on_stage
    report = bench_stream(pipeline, seconds=3)
    assert pipeline.on_stage is before, "the pipeline goes on without the timer"
    chunks = round(3 / pipeline.chunk.seconds)
    stages = [timer.stages[stage][-chunks:] for stage in STAGES]
    parts, whole = np.median(np.sum(stages, axis=0)), report.stages_ms["whole chunk"][0]
    assert 0.5 * whole < parts <= whole
    assert abs(report.summary["seconds"] - 3) < 0.3


def test_several_sessions_share_a_tick(tiny_bundle: Path) -> None:
    report = bench_stream(Pipeline(load_bundle(tiny_bundle)), seconds=1, sessions=3)
    assert report.summary["sessions"] == 3


@pytest.mark.parametrize("of", ["tiny", "shipped"])
def test_the_papers_own_order_can_be_timed(of: str, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In small: the order of the paper's size, which prefills its window at every step; graphs have another chunk."""

    def small(layout: TokenLayout, sequence: Any) -> GeneratorConfig:
        sizes = {"width": 64, "layers": 1, "heads": 4, "kv_heads": 2, "mlp": 64}
        return qwen_half_billion(layout, sequence).model_copy(update=sizes)

    monkeypatch.setattr(bundles, "qwen_half_billion", small)
    bundle = bundles.with_random_generator(load_bundle(tiny_bundle if of == "tiny" else "default"))
    pipeline = Pipeline(bundle)
    assert bundle.sizes.sequence == "prefix"
    assert bench_stream(pipeline, seconds=0.6).stages_ms["generator"][0] > 0
