from collections.abc import Callable

import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine import Session, SessionCore
from echoavatar.engine.pipeline import Action, ActionLibrary
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
    assert session._host._rows.state.total.item() == 8_000


def test_music_is_made_a_second_ahead_of_the_player_at_most() -> None:
    """So that speech which begins is heard within that time; and not less, or a busy machine would be heard."""
    machine = engine()
    session = machine.open_core()
    session.report_played(0)
    session.play("tone", np.ones(20 * 24_000, np.float32))
    while machine.tick():
        pass
    assert 0.6 < session.made / 24_000 < 1.1


def speaking(seconds: float) -> SessionCore:
    """A session whose player stands at the start, with so much speech made ahead of it."""
    machine = engine()
    machine.actions = ActionLibrary({"wave": Action("wave", (1, 2, 3, 4), (0, 1))})
    session = machine.open_core()
    session.report_played(0)
    session.push(np.ones(round(seconds * 24_000), np.float32))
    while machine.tick():
        pass
    return session


def test_an_action_begins_soon_although_motion_was_made_ahead() -> None:
    """Within half a second; and nothing is made again for what would begin as soon by itself."""
    session = speaking(2.0)
    assert session.act("wave").at / 24_000 < 0.6
    session = speaking(0.54)
    assert session.made == 12_800
    assert session.act("wave").at == 12_800
    assert session.epoch == 0


@pytest.mark.parametrize("stop", [SessionCore.stop_acting, SessionCore.stop_music])
def test_the_engine_hears_at_once_of_a_stop_that_takes_motion_back(stop: Callable[[SessionCore], None]) -> None:
    """Else its threads sleep for up to a second, longer than the motion that is left lasts."""
    session = speaking(2.0)
    before = session._host.wakes
    stop(session)
    assert session.is_ready
    assert session._host.wakes > before


def test_a_session_can_go_back_four_seconds() -> None:
    """What was heard is known to the sample within them; what lies further back is kept."""
    session = speaking(8.0)
    assert session.interrupt(round(4.4 * 24_000)).at == round(4.4 * 24_000)
    session = speaking(8.0)
    assert 3.8 < session.made / 24_000 - session.interrupt(0).at / 24_000 < 4.3
