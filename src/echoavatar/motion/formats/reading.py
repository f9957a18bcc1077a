"""What every reader of a body says: the file's name before each error, and what was assumed in one warning."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from echoavatar.errors import MotionError

_log = logging.getLogger(__name__)


@contextmanager
def reading(path: Path) -> Iterator[list[str]]:
    """A context in which each MotionError names the file. Notes that are put into its list become one warning."""
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
