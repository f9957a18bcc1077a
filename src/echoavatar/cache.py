"""Folders for what can be made again. A cache saves time and is never a condition. Uses nothing else of the package."""

import functools
import logging
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

_LOG = logging.getLogger(__name__)
NOWHERE = Path(os.devnull) / "echoavatar"  # nothing can be written there


def user_caches() -> list[Path]:
    """The package's folder in the user's cache; none for a user without a home, as containers have."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():  # the standard says to ignore others
        return [named / "echoavatar"]
    try:
        home = Path.home()
    except RuntimeError:  # nobody knows it
        return []
    caches = home / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return [caches / "echoavatar"] if home != Path(home.anchor) else []  # / is nobody's home


def first_writable(*places: Path) -> Path:
    """The first of these folders that can be written; it is made. If none can, a temporary one, and a warning says so.

    The temporary folder ends with the process. Where there is none either, every write to the returned path fails.
    """
    for place in places:
        if place.parts[:1] != ("~",):  # a library could not find the home
            with suppress(OSError):
                place.mkdir(parents=True, exist_ok=True)
                tempfile.TemporaryFile(dir=place).close()
                return place
    made = _temporary()
    return NOWHERE if made is None else Path(made.name)


@functools.cache
def _temporary() -> "tempfile.TemporaryDirectory[str] | None":
    """A folder that nobody else can write: compiled code is read from it."""
    try:
        made = tempfile.TemporaryDirectory(prefix="echoavatar-", ignore_cleanup_errors=True)
    except OSError:
        made = None
    _LOG.warning(
        "no cache can be written, so each start compiles anew (%s); set XDG_CACHE_HOME to a folder of yours",
        f"kept in {made.name} meanwhile" if made else "TMPDIR cannot be written either",
    )
    return made
