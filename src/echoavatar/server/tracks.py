"""The music a server can play: what ships, and a folder of the owner's."""

from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..audio import read_audio
from ..errors import EchoAvatarError

_KINDS = (".flac", ".m4a", ".mp3", ".ogg", ".opus", ".wav")


class Tracks:
    """Titles and their sound; a title is a file's name without its ending."""

    def __init__(self, folder: Path | None = None) -> None:
        """Raises EchoAvatarError when the folder is not there."""
        with as_file(files("echoavatar") / "assets" / "music.ogg") as shipped:
            self._paths = {"Demo": shipped}
        if folder is not None:
            if not folder.is_dir():
                raise EchoAvatarError(f"no folder {folder} with music; make it or leave --music out")
            found = sorted(path for path in folder.iterdir() if path.suffix.lower() in _KINDS)
            self._paths |= {path.stem[:128]: path for path in found}

    @property
    def titles(self) -> tuple[str, ...]:
        """What can be played."""
        return tuple(self._paths)

    def load(self, title: str) -> Float[np.ndarray, " s"]:
        """A track's sound, 24 kHz mono; slow, so not for the event loop.

        Raises:
            EchoAvatarError: no such title, or a file that cannot be read.
        """
        if title not in self._paths:
            raise EchoAvatarError(f"no track {title!r}; there are {', '.join(self._paths)}")
        return _read(self._paths[title])


@lru_cache(maxsize=8)
def _read(path: Path) -> Float[np.ndarray, " s"]:
    return read_audio(path)
