import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine import Session
from echoavatar.engine.session_core import ChunkPlan


def test_an_interruption_in_the_moment_a_chunk_begins_is_put_back_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker has claimed the session, and has not yet taken its sound."""
    session = engine().open_core()
    session.push(np.ones(19_200, np.float32))
    assert len(list(Session(session))) == 3
    begin, cuts = session.begin_chunk, [8_000]

    def late(codes: int) -> ChunkPlan:
        while cuts:
            assert session.interrupt(cuts.pop()).at == 8_000
        return begin(codes)

    monkeypatch.setattr(session, "begin_chunk", late)
    session.push(np.full(6_400, 2, np.float32))  # forgotten with what was not heard
    session._host.tick()
    delivery = session.take()
    assert delivery is not None
    assert (delivery.start, delivery.epoch) == (8_000, 1)
    assert session._host._state.total.item() == 8_000
