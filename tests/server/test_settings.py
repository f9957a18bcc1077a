from echoavatar.engine.engine import REWIND_S
from echoavatar.server import ServerSettings
from echoavatar.timing import CHUNK_SECONDS


def test_clients_are_told_what_holds() -> None:
    limits = ServerSettings(inbox_seconds=7.0, ahead_seconds=1.5).limits
    assert (limits.inbox_seconds, limits.ahead_seconds, limits.message_bytes) == (7.0, 1.5, 1 << 23)


def test_all_that_was_sent_ahead_can_be_taken_back() -> None:
    """Look-ahead, a chunk in the making and one of rounding."""
    assert ServerSettings().ahead_seconds + 2 * CHUNK_SECONDS < REWIND_S
