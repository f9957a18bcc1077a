"""Music that a session hears and plays: one track at a time, quieter under speech, faded out when stopped.

`Tracks` is the library: tracks that ship with the package, and a folder of the user's. Everything is counted in samples
of the session's clock, so a session that goes back plays the same music again.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME, ChunkSize

Samples = Float[np.ndarray, " s"]
DUCKED = 0.35  # level of music under speech
DUCK_S = 0.25  # from full level to ducked, and back
FADE_S = 0.4
AUDIBLE = 1e-3  # a frame with this peak counts as speech
HOLD_FRAMES = 12  # 0.4 s: pauses between words do not bring the music back


class Heard(NamedTuple):
    """One chunk of sound as the avatar hears it: speech and music."""

    speech: Samples
    music: Samples | None  # as it must be played; None if none plays

    @property
    def audio(self) -> Samples:
        """The mix."""
        return self.speech if self.music is None else self.speech + self.music


@dataclass(frozen=True)
class Playing:
    """The player's state: a value, so that a session can go back to it."""

    title: str = ""
    track: Samples | None = field(default=None, compare=False)
    at: int = 0  # samples of the track played so far
    duck: float = 1.0
    quiet: int = HOLD_FRAMES  # frames since the last speech
    fade: float = 1.0
    is_stopping: bool = False


class MusicPlayer:
    """Plays one session's music."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self.now = Playing()
        self._size = chunk.samples
        self._commands: list[tuple[int, str, Samples | None]] = []  # chunk, title and track; None to stop
        self._chunk = 0

    @property
    def is_playing(self) -> bool:
        """Whether the next chunk will hold music."""
        return self.now.track is not None

    def play(self, title: str, track: Samples | None) -> None:
        """Play a track (24 kHz mono) from the next chunk on, instead of the one that plays; None fades that one out."""
        self._commands = [*self._commands[-63:], (self._chunk, title, track)]
        self.now = replace(self.now, is_stopping=True) if track is None else Playing(title, track)

    def stop(self) -> None:
        """Fade out from the next chunk on."""
        self.play("", None)

    def next_chunk(self, speech: Samples) -> Samples | None:
        """Music for the next chunk, ducked under its speech; None if none plays."""
        self._chunk += 1
        now = self.now
        if now.track is None:
            return None
        piece = now.track[now.at : now.at + self._size]
        duck, quiet = _ducking(speech, now)
        step = 1 / (FADE_S * SAMPLE_RATE_HZ) if now.is_stopping else 0.0
        fade = np.maximum(now.fade - step * np.arange(1, self._size + 1), 0)
        music = np.zeros(self._size, np.float32)
        music[: len(piece)] = piece * (duck * fade)[: len(piece)]
        end = now.at + self._size
        self.now = replace(now, at=end, duck=float(duck[-1]), quiet=quiet, fade=float(fade[-1]))
        if end >= len(now.track) or fade[-1] <= 0:
            self.now = Playing()
        return music

    def rewind(self, chunk: int, now: Playing) -> None:
        """Go back to the state before chunk number `chunk`; commands given since then take effect again."""
        again = [command for command in self._commands if command[0] >= chunk]
        self._commands = [command for command in self._commands if command[0] < chunk]
        self._chunk, self.now = chunk, now
        for _, title, track in again:
            self.play(title, track)


def _ducking(speech: Samples, now: Playing) -> tuple[Float[np.ndarray, " s"], int]:
    """The level of the music, sample by sample, and the frames since the last speech."""
    levels, duck, quiet = [], now.duck, now.quiet
    step = (1 - DUCKED) * SAMPLES_PER_FRAME / (DUCK_S * SAMPLE_RATE_HZ)
    for frame in speech.reshape(-1, SAMPLES_PER_FRAME):
        quiet = 0 if np.abs(frame).max() > AUDIBLE else quiet + 1
        target = max(duck - step, DUCKED) if quiet < HOLD_FRAMES else min(duck + step, 1.0)
        levels.append(np.linspace(duck, target, SAMPLES_PER_FRAME + 1)[1:])
        duck = target
    return np.concatenate(levels), quiet


class Tracks:
    """Tracks by title. A title is a file's name without its suffix, with blanks for underscores."""

    def __init__(self, folder: Path | None = None) -> None:
        """A track in `folder` replaces a shipped one of the same title.

        Raises EchoAvatarError if the folder does not exist.
        """
        with as_file(files("echoavatar") / "assets" / "music") as shipped:
            self._paths = _found(shipped) if shipped.is_dir() else {}
        if folder is not None:
            if not folder.is_dir():
                raise EchoAvatarError(f"no folder {folder} with music; make it, or name another")
            self._paths |= _found(folder)
        self.titles = tuple(self._paths)

    def find(self, title: str | None) -> str:
        """The exact title; case and underscores do not matter. Without a title (None or empty) the first one.

        Raises EchoAvatarError: no such title; the message lists all titles.
        """
        wanted = (title or next(iter(self._paths), "")).replace("_", " ").strip().lower()
        for own in self._paths:
            if own.lower() == wanted:
                return own
        why = f"no music {title!r}; there is: {', '.join(self._paths)}" if self._paths else "there is no music"
        raise EchoAvatarError(why)

    def load(self, title: str) -> Float[np.ndarray, " s"]:
        """A track, 24 kHz mono. Decoding it takes a while, so call this on a thread of its own.

        Raises EchoAvatarError: no such title, or a file that cannot be read.
        """
        return _read(self._paths[self.find(title)])


def _found(folder: Path) -> dict[str, Path]:
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SOUND_SUFFIXES)
    return {path.stem.replace("_", " ")[:128]: path for path in paths}


@lru_cache(maxsize=8)
def _read(path: Path) -> Float[np.ndarray, " s"]:
    return read_audio(path)
