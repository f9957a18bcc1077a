"""A viewer as a session sees it; the rest is seen from outside in `test_whep`."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("aiortc", reason="pip install 'echoavatar[video]'")

from echoavatar.server.video.viewer import ViewerOutbox
from echoavatar.wire import Flush


def test_messages_pass_at_once_and_the_clock_runs_only_with_a_source() -> None:
    told: list[Any] = []
    session = SimpleNamespace(source=None)
    outbox = ViewerOutbox(cast(Any, SimpleNamespace(take=told.append)), cast(Any, session), lambda: told.append("end"))
    assert not outbox.plays
    session.source = object()
    assert outbox.plays
    outbox.put(Flush(at=1, epoch=1, seg=0, heard=0))
    assert len(outbox) == 0
    outbox.close()
    assert [type(one).__name__ for one in told] == ["Flush", "str"]
