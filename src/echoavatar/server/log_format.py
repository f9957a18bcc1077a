"""Log records as lines of JSON, for programs that collect logs: `serve --log json`."""

import json
import logging
import time


class JsonFormatter(logging.Formatter):
    """One object a line: time in UTC, level, logger, message, and where there are any, session and traceback."""

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record; `extra={"session": name}` names a session."""
        line = {
            "time": f"{self.formatTime(record, '%Y-%m-%dT%H:%M:%S')}.{record.msecs:03.0f}Z",
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if isinstance(session := getattr(record, "session", None), str):
            line["session"] = session
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json.dumps(line)


def log_json() -> None:
    """Log in JSON from now on."""
    for handler in logging.getLogger().handlers:
        handler.setFormatter(JsonFormatter())
