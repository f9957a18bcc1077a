"""Cache folders. The package also runs where none can be written, only slower. Uses nothing else of the package."""

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
    """The package's folder in the user's cache; an empty list for a user without a home, as in containers."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():  # the XDG standard says to ignore relative paths
        return [named / "echoavatar"]
    try:
        home = Path.home()
    except RuntimeError:  # the user has no home
        return []
    caches = home / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return [caches / "echoavatar"] if home != Path(home.anchor) else []  # / counts as no home


def first_writable(*places: Path) -> Path:
    """The first of these folders that can be written; it is made. If none can, a temporary one, and a warning.

    The temporary folder is removed when the process ends. If it cannot be made either, `NOWHERE` is returned.
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
    """A folder that no other user can write, because compiled code is loaded from it; None where none can be made."""
    try:
        made = tempfile.TemporaryDirectory(prefix="echoavatar-", ignore_cleanup_errors=True)
    except OSError:
        made = None
    _LOG.warning(
        "no cache can be written, so each start compiles anew (%s); set XDG_CACHE_HOME to a folder of yours",
        f"kept in {made.name} meanwhile" if made else "TMPDIR cannot be written either",
    )
    return made
