"""Counters and gauges for Prometheus."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from echoavatar.timing import CHUNK_SECONDS

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_BUCKETS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, CHUNK_SECONDS, 0.4, 0.6, 1.0, 2.0)


class Metrics:
    """The metrics of one server, in a registry of its own, so that a process can hold several servers."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.seats = Gauge("echoavatar_seats", "Most sessions there can be", registry=self.registry)
        self.room = Gauge("echoavatar_room", "Sessions that the machine carries now", registry=self.registry)
        self.sessions = Gauge("echoavatar_sessions", "Sessions there are", registry=self.registry)
        self.connections = Gauge("echoavatar_connections", "Open connections", registry=self.registry)
        self.chunks = Counter("echoavatar_chunks", "Chunks of motion made", registry=self.registry)
        self.latency = Histogram(
            "echoavatar_chunk_seconds",
            "From a chunk's sound being complete to its motion being sent",
            buckets=_BUCKETS,
            registry=self.registry,
        )
        self.step = Gauge("echoavatar_step_seconds", "The engine's last step", registry=self.registry)
        self.messages = Counter("echoavatar_messages", "Messages", ["direction", "type"], registry=self.registry)
        self.errors = Counter("echoavatar_errors", "Errors told to clients", ["code"], registry=self.registry)
        self.refused = Counter("echoavatar_refused", "Connections refused before hello", registry=self.registry)
        self.dropped = Counter("echoavatar_dropped_motion", "Motion not sent to slow clients", registry=self.registry)
        self.interrupts = Counter("echoavatar_interrupts", "Barge-ins", registry=self.registry)
        self.resumed = Counter("echoavatar_resumed", "Sessions that came back", registry=self.registry)
        self.faults = Counter("echoavatar_session_faults", "Sessions that a fault ended", registry=self.registry)
        self.restarts = Counter("echoavatar_engine_restarts", "Restarts after a fault", registry=self.registry)
        self.viewers = Gauge("echoavatar_video_viewers", "WebRTC viewers", registry=self.registry)
        self.pictures = Counter("echoavatar_video_pictures", "For past viewers", ["fate"], registry=self.registry)

    def text(self) -> bytes:
        """The answer to `GET /metrics`."""
        return generate_latest(self.registry)
