import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine import Session, SessionStatus
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
        assert [round(float(chunk.root[0, 1]), 3) for chunk in chunks] == [6400, 6401]  # the fake sums what it hears
        with pytest.raises(EchoAvatarError, match="finished"):
            session.push(np.ones(1, np.float32))


def test_a_stalled_source_is_heard_as_silence() -> None:
    with engine().open() as session:
        session.push(np.ones(100, np.float32))
        session.core.stall()
        session.core.stall()  # a second call in the same chunk adds nothing
        assert len(list(session)) == 1


def test_clear_forgets_unheard_audio_and_unread_motion_but_not_the_past() -> None:
    with engine().open() as session:
        session.push(np.ones(12_800, np.float32))
        session.core._host.tick()
        session.core._host.tick()
        assert session.core.take() is not None
        session.push(np.ones(9_000, np.float32))
        assert session.clear() == 6_400
        assert list(session) == []
        session.push(np.full(6_400, 2, np.float32))
        list(session)
        assert session.core._host._rows.state.total.item() == 6_400 + 12_800  # what was taken before stays heard


def test_any_rate_is_accepted_and_bad_values_are_named() -> None:
    with engine().open() as session:
        session.push(np.zeros((8_000, 6), np.float32), rate=8_000)
        session.finish()
        assert len(list(session)) == 4  # one second is 3.75 chunks
    with engine().open() as session, pytest.raises(AudioError, match="is nan"):
        session.push(np.array([0.0, np.nan], np.float32))


def test_a_queue_that_overflows_says_what_to_do() -> None:
    with engine().open() as session, pytest.raises(EchoAvatarError, match="600 s of audio are waiting"):
        session.push(np.zeros(24_000 * 601, np.float32))


def test_the_public_face_is_small() -> None:
    """README: `push`, `clear` and iterate; the rest are requests, one status, and the end."""
    public = {name for name in dir(Session) if not name.startswith("_")}
    assert public == {"push", "clear", "finish", "listen", "act", "play", "stop_music", "status", "close"} | {
        "set_manner",
        "words",
    }


def test_the_status_tells_how_the_session_is_doing() -> None:
    with engine().open() as session:
        session.push(np.full(9_600, 0.5, np.float32))
        assert session.status.seconds_waiting == 0.4
        list(session)
        assert session.status._replace(seconds_waiting=0.0) == SessionStatus("speech", False, 6_400, 0.0, 0)
