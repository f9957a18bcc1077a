import json
import logging

from echoavatar.server.log_format import JsonFormatter


def test_a_record_is_one_line_of_json_with_its_session_and_trace() -> None:
    log = logging.Logger("echoavatar.server")
    lines: list[str] = []
    log.handle = lambda record: lines.append(JsonFormatter().format(record))  # type: ignore[method-assign]
    try:
        raise MemoryError("no\nroom")
    except MemoryError:
        log.exception("session %s failed", "abc", extra={"session": "abc"})
    log.warning("told")
    failed, told = (json.loads(line) for line in lines)
    assert not any("\n" in line for line in lines)
    assert (failed["level"], failed["session"], failed["message"]) == ("ERROR", "abc", "session abc failed")
    assert failed["trace"].endswith("room")
    assert set(told) == {"time", "level", "logger", "message"}
    assert told["time"].endswith("Z")
