"""What all readers of bodies and motion report: errors that name the file, and one warning of all assumptions."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from echoavatar.errors import MotionError

_log = logging.getLogger(__name__)


@contextmanager
def reading(path: Path) -> Iterator[list[str]]:
    """A context in which each MotionError names the file. Notes appended to its list become one warning at its end."""
    notes = list[str]()
    try:
        yield notes
    except ValidationError as error:
        raise MotionError(f"{path}: {error.errors()[0]['msg']}; repair the file") from error
    except MotionError as error:
        if not str(error).startswith(tuple(f"{path}{sign}" for sign in ":, ")):
            error.args = (f"{path}: {error}",)
        raise
    if notes:
        _log.warning("%s: %s", path, "; ".join(notes))
