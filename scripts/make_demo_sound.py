"""Make the sample sound: a recorded voice cut at both ends, and half a minute of our own music.

    python scripts/make_demo_sound.py 6064-300880-0000.flac        (of LibriSpeech; NOTICE has the credit)

Writes src/echoavatar/assets/speech.ogg and music.ogg, mono 24 kHz Vorbis. The music is composed and rendered by
`echoavatar_lab.corpora.rehearsal`.
"""

import sys
from pathlib import Path

import numpy as np
import soundfile

from echoavatar.models.audio import read_audio
from echoavatar_lab.corpora.music.instruments import render
from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.sound import whole_frames

ASSETS = Path(__file__).parents[1] / "src" / "echoavatar" / "assets"
RATE = 24_000
AUDIBLE = 0.01  # RMS of 25 ms
FADE = RATE // 20


def main() -> None:
    """Write both files."""
    voice = read_audio(Path(sys.argv[1]))
    level = np.sqrt(np.convolve(voice**2, np.full(RATE // 40, 40 / RATE), "same"))
    spoken = np.flatnonzero(level > AUDIBLE)
    speech = set_loudness(voice[max(0, spoken[0] - RATE // 4) : spoken[-1] + RATE // 3], -20)
    speech[:FADE] *= np.linspace(0, 1, FADE)
    speech[-FADE:] *= np.linspace(1, 0, FADE)
    rng = np.random.default_rng(21)
    piece = compose_piece(rng, 26.0, "house")
    music = set_loudness(whole_frames(render(piece, rng)), -18)
    music = np.concatenate([np.zeros(12_000, np.float32), music[: 25 * RATE], np.zeros(60_000, np.float32)])
    for name, audio in (("speech", speech), ("music", music)):
        path = ASSETS / f"{name}.ogg"
        soundfile.write(path, audio, RATE, format="OGG", subtype="VORBIS")
        print(f"{path.name}: {len(audio) / RATE:.1f} s, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
