"""OpenTelemetry traces: one for every chunk, from the arrival of its sound to the sending of its pose.

`chunk` begins when the oldest sound in it came, or when its silence was scheduled. Below it are `wait` (for its place
on the clock), `queue` (for the engine), `step` with a span for each of the pipeline's stages, and `deliver`.
"""

import threading
import time
from collections import deque
from typing import Any

from opentelemetry import trace
from opentelemetry.trace import Tracer

from echoavatar.engine import Engine
from echoavatar.outgoing import proxy_for
from echoavatar.timing import SAMPLE_RATE_HZ

MOST_OPEN = 64  # chunks of a session that are scheduled and not shown; more than can be on their way

Times = list[tuple[str, int]]  # name of a stage, and its end in nanoseconds of `time.monotonic_ns`


def export_to(address: str) -> Tracer:
    """A tracer whose spans go to an OTLP collector over HTTP, such as http://127.0.0.1:4318/v1/traces.

    Raises ModuleNotFoundError if the extra `traces` is not installed.
    """
    import requests
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    session = requests.Session()
    session.trust_env = proxy_for(address) is not None  # otherwise a proxy would get requests to this machine, too
    provider = TracerProvider(resource=Resource.create({"service.name": "echoavatar"}))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(address, session=session)))
    tracer: Tracer = provider.get_tracer("echoavatar")
    return tracer


class Tracing:
    """Notes when the stages of a step end, thread by thread."""

    def __init__(self, engine: Engine, tracer: Tracer) -> None:
        self.tracer = tracer
        self._here, self._pipeline = threading.local(), None
        engine.on_step = self._begin

    def step(self) -> Times:
        """The beginning and the stages of the step that this thread makes, or made last."""
        return list(getattr(self._here, "times", ()))

    def _begin(self, pipeline: Any) -> None:
        if pipeline is not self._pipeline:  # the first, or loaded again
            self._pipeline, pipeline.on_stage = pipeline, self._end_stage
        self._here.times = [("queue", time.monotonic_ns())]

    def _end_stage(self, stage: str) -> None:
        self._here.times.append((stage, time.monotonic_ns()))


class SessionTrace:
    """The chunks of one session on their way. `made` is called in the engine's threads, all else on the event loop."""

    def __init__(self, tracing: Tracing, session: str) -> None:
        self._tracing, self._session = tracing, session
        self._waiting: deque[tuple[float, int]] = deque()  # seconds of sound that wait for a chunk, and when they came
        self._open: dict[int, Times] = {}  # by clock: stages in order; the first entry is the beginning

    def heard(self, samples: int, rate: int) -> None:
        """Sound came."""
        self._waiting.append((samples / rate, time.monotonic_ns()))

    def scheduled(self, at: int, samples: int) -> None:
        """The chunk at a clock is on its way, with the sound that waited longest."""
        now, seconds = time.monotonic_ns(), samples / SAMPLE_RATE_HZ
        began = self._waiting[0][1] if self._waiting else now
        while seconds > 0 and self._waiting:
            there, came = self._waiting.popleft()
            if there > seconds:
                self._waiting.appendleft((there - seconds, came))
            seconds -= there
        self._open[at] = [("chunk", began), ("wait", now)]
        while len(self._open) > MOST_OPEN:  # taken back, and never shown
            del self._open[next(iter(self._open))]

    def made(self, at: int) -> None:
        """The chunk at a clock is made, by this thread."""
        if (times := self._open.get(at)) is not None:
            times[2:] = [*self._tracing.step(), ("step", time.monotonic_ns())]

    def shown(self, at: int) -> None:
        """The pose of a chunk goes to the clients: write its spans."""
        times = self._open.pop(at, None)
        if times is None or len(times) < 4:
            return
        tracer, end = self._tracing.tracer, time.time_ns()
        # one difference for all of a chunk: the wall clock may be set, but no span ends before it begins
        since_1970 = end - time.monotonic_ns()
        (_, began), (_, scheduled), (_, stepped), *stages, (_, made) = [(name, at + since_1970) for name, at in times]
        scheduled = min(scheduled, stepped)  # a worker may begin before this is noted
        chunk = tracer.start_span("chunk", start_time=began, attributes={"session": self._session, "at": at})
        inside = trace.set_span_in_context(chunk)
        for name, start, stop in (
            ("wait", began, scheduled), ("queue", scheduled, stepped), ("deliver", made, end),
        ):  # fmt: skip
            tracer.start_span(name, inside, start_time=start).end(stop)
        step = tracer.start_span("step", inside, start_time=stepped)
        below, last = trace.set_span_in_context(step), stepped
        for name, stop in stages:
            tracer.start_span(name, below, start_time=last).end(stop)
            last = stop
        step.end(made)
        chunk.end(end)

    def forget(self) -> None:
        """Waiting sound was taken back."""
        self._waiting.clear()
