"""Compose and render the small music library that ships for `play_music`.

    python scripts/make_music.py

Writes src/echoavatar/assets/music/*.ogg, mono 24 kHz Vorbis. They are composed by rule and rendered by our own
synthesiser (`echoavatar_lab.corpora.rehearsal`) without samples or a soundfont, so the project's licence covers them.
"""

from pathlib import Path

import numpy as np
import soundfile

from echoavatar_lab.corpora.music.instruments import render
from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.sound import whole_frames

FOLDER = Path(__file__).parents[1] / "src" / "echoavatar" / "assets" / "music"
SECONDS = 42.0
TRACKS = {  # title: style, seed
    "Bright_House": ("house", 31),
    "Corner_Swing": ("swing", 44),
    "Evening_Waltz": ("waltz", 52),
    "Warm_Salsa": ("salsa", 63),
}


def main() -> None:
    """Write every track."""
    FOLDER.mkdir(exist_ok=True)
    for title, (style, seed) in TRACKS.items():
        rng = np.random.default_rng(seed)
        piece = compose_piece(rng, SECONDS, style)
        music = set_loudness(whole_frames(render(piece, rng)), -18)
        fade = np.clip((len(music) - np.arange(len(music))) / 24_000, 0, 1).astype(np.float32)
        path = FOLDER / f"{title}.ogg"
        soundfile.write(path, music * fade, 24_000, format="OGG", subtype="VORBIS")
        print(f"{path.name}: {len(music) / 24_000:.1f} s, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
