import dataclasses
import sys
import time
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tests.engine.fakes import Heard
from tests.server.fakes import FAST, Body, serving

pytest.importorskip("opentelemetry.sdk", reason="needs pip install 'echoavatar[traces]'")

from opentelemetry.sdk.trace import ReadableSpan, TracerProvider  # noqa: E402
from opentelemetry.sdk.trace.export import SimpleSpanProcessor  # noqa: E402
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter  # noqa: E402

from echoavatar.engine import Engine  # noqa: E402
from echoavatar.server.tracing import SessionTrace, Tracing, export_to  # noqa: E402
from echoavatar.wire.messages import Hello, Interrupt, Motion  # noqa: E402


class Staged(Body):
    """Its steps tell of two stages; the second takes 20 ms."""

    on_stage: Any = None

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> Any:
        self.on_stage("codec")
        time.sleep(0.02)
        self.on_stage("generator")
        return super().step(audio, state, active)


def of_trace(spans: tuple[ReadableSpan, ...], chunk: ReadableSpan) -> dict[str, ReadableSpan]:
    return {span.name: span for span in spans if span.context.trace_id == chunk.context.trace_id}


def length_s(span: ReadableSpan) -> float:
    assert span.start_time is not None
    assert span.end_time is not None
    return (span.end_time - span.start_time) / 1e9


def test_each_chunk_is_a_trace_from_its_sound_to_its_pose_with_its_stages() -> None:
    kept = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(kept))
    settings = dataclasses.replace(FAST, tracer=provider.get_tracer("test"))
    with serving(settings=settings, pipeline=Staged()) as server, server.call(Hello()) as caller:
        caller.until(Motion)
        before = time.time_ns()
        caller.speak(1, np.full(3 * 6_400, 0.2, np.float32))
        for _ in range(2):
            caller.until(Motion, lambda motion: motion.state == "speaking")
        caller.say(Interrupt(seg=1))
        caller.until(Motion, lambda motion: motion.epoch > 0)
        name = caller.ready.session
    spans = kept.get_finished_spans()
    chunks = [span for span in spans if span.name == "chunk"]
    assert len(chunks) > 2
    assert {dict(chunk.attributes or {})["session"] for chunk in chunks} == {name}
    for chunk in chunks:
        parts = of_trace(spans, chunk)
        assert set(parts) == {"chunk", "wait", "queue", "step", "codec", "generator", "deliver"}
        whole = [length_s(parts[part]) for part in ("wait", "queue", "step", "deliver")]
        assert all(seconds >= 0 for seconds in whole)
        assert sum(whole) == pytest.approx(length_s(chunk), abs=1e-6)
        assert length_s(parts["generator"]) >= 0.02
        assert parts["codec"].parent is not None
        assert parts["codec"].parent.span_id == parts["step"].context.span_id
    spoken = [chunk for chunk in chunks if length_s(of_trace(spans, chunk)["wait"]) > 0]
    assert spoken  # sound waited for its place on the clock
    assert all(chunk.start_time and chunk.start_time >= before for chunk in spoken)


def test_a_pipeline_that_is_loaded_again_is_traced_again() -> None:
    kept = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(kept))
    settings = dataclasses.replace(FAST, tracer=provider.get_tracer("test"))
    with serving(settings=settings, pipeline=Staged()) as server, server.call(Hello()) as caller:
        at = caller.until(Motion).at
        engine = server.manager.engine
        engine._reload = Staged
        engine.pipeline.seconds = "not a number of seconds"
        caller.until(Motion, lambda motion: motion.at > at and engine.restarts == 1)
        kept.clear()
        caller.until(Motion)
        caller.until(Motion)
    assert "generator" in {span.name for span in kept.get_finished_spans()}


def test_spans_follow_a_wall_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour ahead in the middle of a chunk: its spans are of one clock, and the new one."""
    kept = InMemorySpanExporter()
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(kept))
    tracing = Tracing(Engine(Staged()), provider.get_tracer("test"))  # type: ignore[arg-type]
    session = SessionTrace(tracing, "s")
    session.scheduled(0, 6_400)
    tracing._begin(Staged())
    session.made(0)
    ahead = time.time_ns() + 3_600 * 10**9
    monkeypatch.setattr("time.time_ns", lambda: ahead)
    session.shown(0)
    for span in kept.get_finished_spans():
        assert 0 <= length_s(span) < 60
        assert abs(span.end_time - ahead) < 60 * 10**9


@pytest.mark.parametrize(("collector", "is_proxied"), [("http://127.0.0.1:4318", False), ("http://8.8.8.8:4318", True)])
def test_a_collector_of_this_machine_is_not_asked_through_a_proxy(
    collector: str, is_proxied: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("requests")
    told: list[bool] = []

    def exporter(address: str, session: Any) -> Any:
        told.append(session.trust_env)
        return InMemorySpanExporter()

    name = "opentelemetry.exporter.otlp.proto.http.trace_exporter"  # a stand-in, also where it is installed
    for end in range(2, len(name.split(".")) + 1):
        monkeypatch.setitem(sys.modules, ".".join(name.split(".")[:end]), ModuleType(name))
    monkeypatch.setattr(sys.modules[name], "OTLPSpanExporter", exporter, raising=False)
    monkeypatch.setattr("opentelemetry.sdk.trace.export.BatchSpanProcessor", SimpleSpanProcessor)
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.delenv("NO_PROXY", raising=False)
    monkeypatch.delenv("no_proxy", raising=False)
    export_to(f"{collector}/v1/traces")
    assert told == [is_proxied]
