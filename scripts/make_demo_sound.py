"""Make the demo's sound: a short welcome spoken by flite, and half a minute of our own music.

    python scripts/make_demo_sound.py            (Debian: apt install flite libflite1)

Writes src/echoavatar/assets/speech.ogg and music.ogg, mono 24 kHz Vorbis. Both may be redistributed: flite's voices
put no condition on their output, and the music is composed and rendered by `echoavatar.corpora.rehearsal`.
"""

from pathlib import Path

import numpy as np
import soundfile

from echoavatar.corpora.rehearsal.augment import fill_band, set_loudness
from echoavatar.corpora.rehearsal.instruments import render
from echoavatar.corpora.rehearsal.music import compose_piece
from echoavatar.corpora.rehearsal.prosody import Delivery
from echoavatar.corpora.rehearsal.script import Sentence, parse_words
from echoavatar.corpora.rehearsal.sound import whole_frames
from echoavatar.corpora.rehearsal.speech import speak

ASSETS = Path(__file__).parents[1] / "src" / "echoavatar" / "assets"
TEXT = (
    "hello^greeting, I am so *happy to see you.",
    "everything you see is made from *sound alone.",
    "my hands, my steps, and the way I *stand.",
    "I do not^negation know what comes *next.",
    "I hear *you, and I *move.",
    "give me a *big^size word, and I will show you how *big^size it is.",
    "now let us try some *music.",
)


def main() -> None:
    """Write both files."""
    rng = np.random.default_rng(11)
    sentences = tuple(Sentence(parse_words(text), f"demo {i}") for i, text in enumerate(TEXT))
    said = speak(sentences, Delivery(voice="slt", rate=1.02, spread=2.0, bump_semitones=5.0), rng, "flite")
    speech = set_loudness(fill_band(said.audio, rng), -20)
    speech = np.concatenate([np.zeros(12_000, np.float32), speech, np.zeros(48_000, np.float32)])
    rng = np.random.default_rng(21)
    piece = compose_piece(rng, 26.0, "house")
    music = set_loudness(whole_frames(render(piece, rng)), -18)
    music = np.concatenate([np.zeros(12_000, np.float32), music[: 25 * 24_000], np.zeros(60_000, np.float32)])
    for name, audio in (("speech", speech), ("music", music)):
        path = ASSETS / f"{name}.ogg"
        soundfile.write(path, audio, 24_000, format="OGG", subtype="VORBIS")
        print(f"{path.name}: {len(audio) / 24_000:.1f} s, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
