from echoavatar.server.metrics import Metrics


def test_every_server_counts_for_itself() -> None:
    one, other = Metrics(), Metrics()
    one.chunks.inc()
    one.latency.observe(0.05)
    assert b"echoavatar_chunks_total 1.0" in one.text()
    assert b"echoavatar_chunks_total 0.0" in other.text()
