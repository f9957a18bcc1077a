import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine.session import Begun
from echoavatar.errors import AudioError, EchoAvatarError


def test_a_chunk_of_audio_gives_a_chunk_of_motion_and_no_more() -> None:
    """12,799 samples are one whole chunk and a rest that waits."""
    with engine().open() as session:
        session.push(np.full(12_799, 0.5, np.float32))
        assert len(list(session)) == 1
        session.push(np.full(1, 0.5, np.float32))
        assert len(list(session)) == 1


def test_finish_completes_the_last_chunk_with_silence_and_ends() -> None:
    with engine().open() as session:
        session.push(np.ones(6_401, np.float32))
        session.finish()
        chunks = list(session)
        assert [float(chunk.root[0, 1]) for chunk in chunks] == [6400, 6401]  # the fake sums what it hears
        with pytest.raises(EchoAvatarError, match="finished"):
            session.push(np.ones(1, np.float32))


def test_a_stalled_source_is_heard_as_silence() -> None:
    with engine().open() as session:
        session.push(np.ones(100, np.float32))
        session.stall()
        session.stall()  # a second call in the same chunk adds nothing
        assert len(list(session)) == 1


def test_clear_forgets_unheard_audio_and_unread_motion_but_not_the_past() -> None:
    with engine().open() as session:
        session.push(np.ones(12_800, np.float32))
        session._engine.tick()
        session._engine.tick()
        assert session.take() is not None
        session.push(np.ones(9_000, np.float32))
        assert session.clear() == 6_400
        assert list(session) == []
        session.push(np.full(6_400, 2, np.float32))
        list(session)
        assert session._engine._state.total.item() == 6_400 + 12_800  # what was taken before stays heard


def test_any_rate_is_accepted_and_bad_values_are_named() -> None:
    with engine().open() as session:
        session.push(np.zeros((8_000, 6), np.float32), rate=8_000)
        session.finish()
        assert len(list(session)) == 4  # one second is 3.75 chunks
    with engine().open() as session, pytest.raises(AudioError, match="is nan"):
        session.push(np.array([0.0, np.nan], np.float32))


def test_an_inbox_that_overflows_says_what_to_do() -> None:
    with engine().open() as session, pytest.raises(EchoAvatarError, match="read motion"):
        session.push(np.zeros(24_000 * 601, np.float32))


def test_an_interruption_in_the_moment_a_chunk_begins_is_put_back_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The lane has claimed the session, and has not yet taken its sound."""
    with engine().open() as session:
        session.push(np.ones(19_200, np.float32))
        assert len(list(session)) == 3
        begin, cuts = session.begin_chunk, [8_000]

        def late(codes: int) -> Begun:
            while cuts:
                assert session.clear(cuts.pop()) == 8_000
            return begin(codes)

        monkeypatch.setattr(session, "begin_chunk", late)
        session.push(np.full(6_400, 2, np.float32))  # forgotten with what was not heard
        session._engine.tick()
        delivery = session.take_timed()
        assert delivery is not None
        assert (delivery.start, delivery.epoch) == (8_000, 1)
        assert session._engine._state.total.item() == 8_000
