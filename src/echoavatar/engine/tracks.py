"""The music library: tracks that ship with the package, and a folder of the user's."""

from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import read_audio

KINDS = (".flac", ".m4a", ".mp3", ".ogg", ".opus", ".wav")


class Tracks:
    """Tracks by title. A title is a file's name without its suffix, with blanks for underscores."""

    def __init__(self, folder: Path | None = None) -> None:
        """A track in `folder` replaces a shipped one of the same title.

        Raises:
            EchoAvatarError: the folder does not exist.
        """
        with as_file(files("echoavatar") / "assets" / "music") as shipped:
            self._paths = _found(shipped) if shipped.is_dir() else {}
        if folder is not None:
            if not folder.is_dir():
                raise EchoAvatarError(f"no folder {folder} with music; make it, or name another")
            self._paths |= _found(folder)

    @property
    def titles(self) -> tuple[str, ...]:
        """All titles."""
        return tuple(self._paths)

    def find(self, title: str) -> str:
        """The exact title; case and underscores do not matter.

        Raises:
            EchoAvatarError: no such title; the message lists all titles.
        """
        wanted = title.replace("_", " ").strip().lower()
        for own in self._paths:
            if own.lower() == wanted:
                return own
        raise EchoAvatarError(f"no music {title!r}; there is: {', '.join(self._paths) or 'none'}")

    def load(self, title: str) -> Float[np.ndarray, " s"]:
        """A track, 24 kHz mono. Decoding it takes a while, so call this on a thread of its own.

        Raises:
            EchoAvatarError: no such title, or a file that cannot be read.
        """
        return _read(self._paths[self.find(title)])


def _found(folder: Path) -> dict[str, Path]:
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in KINDS)
    return {path.stem.replace("_", " ")[:128]: path for path in paths}


@lru_cache(maxsize=8)
def _read(path: Path) -> Float[np.ndarray, " s"]:
    return read_audio(path)
