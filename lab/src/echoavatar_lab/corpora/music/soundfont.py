"""Optional renderer of a `Piece`: pretty_midi writes it and the fluidsynth program plays it with a sound font.

Use sound fonts with a permissive licence only (FluidR3_GM.sf2 is MIT). Not in the paper.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from echoavatar.errors import DependencyError
from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray, Piece
from .instruments import mastered

_LATE_S = 0.0066  # delay of fluidsynth's notes (FluidR3 at 24 kHz)

_PROGRAMS: dict[str, tuple[int, ...]] = {
    "piano": (0, 1, 3), "epiano": (4, 5), "organ": (16, 17, 19), "guitar": (24, 25, 26), "guitar_lead": (27, 29),
    "fuzz": (30, 29), "harp": (46,), "strings": (48, 49), "pad": (88, 89, 91), "brass": (61, 62),
    "accordion": (21, 22), "flute": (73, 75, 72), "clarinet": (71, 66, 68), "trumpet": (56, 59, 60),
    "violin": (40, 41), "cello": (42, 43), "voice_aah": (52, 54), "voice_ooh": (53,), "saw_lead": (81, 84),
    "square_lead": (80, 82), "bell": (14, 11, 9), "finger_bass": (33, 32, 34), "synth_bass": (38, 39),
    "sub_bass": (39, 35), "tuba": (58, 57),
}  # fmt: skip
_DRUMS = {
    "kick": 36, "snare": 38, "clap": 39, "hat": 42, "open_hat": 46, "ride": 51, "crash": 49, "tom_high": 48,
    "tom_low": 43, "conga": 63, "clave": 75, "bell_bar": 56, "shaker": 70, "brush": 40,
}  # fmt: skip


def render_soundfont(piece: Piece, rng: np.random.Generator, font: Path) -> FloatArray:
    """Play a piece with fluidsynth: audio (s,), 24 kHz, peak near 0.9.

    Raises DependencyError if the program or the font is missing.
    """
    program = shutil.which("fluidsynth")
    if program is None:
        raise DependencyError('the fluidsynth program is missing; run "apt install fluidsynth"')
    if not font.is_file():
        raise DependencyError(f'{font} is missing; run "apt install fluid-soundfont-gm"')
    with tempfile.TemporaryDirectory() as folder:
        score, sound = Path(folder, "piece.mid"), Path(folder, "piece.wav")
        _write_midi(piece, rng, score)
        options = ["-ni", "-q", "-R", "0", "-C", "0", "-r", str(SAMPLE_RATE_HZ), "-g", "0.5", "-O", "float"]
        command = [program, *options, "-T", "wav", "-F", str(sound), str(font), str(score)]
        subprocess.run(command, check=True, capture_output=True)
        stereo = soundfile.read(sound, dtype="float32", always_2d=True)[0]
    length = round(piece.seconds * SAMPLE_RATE_HZ)
    mono = stereo.mean(axis=1)[round(_LATE_S * SAMPLE_RATE_HZ) :][:length]
    return mastered(np.pad(mono, (0, length - len(mono))), piece)


def _write_midi(piece: Piece, rng: np.random.Generator, path: Path) -> None:
    import pretty_midi

    midi = pretty_midi.PrettyMIDI(resolution=960, initial_tempo=120)
    for name in sorted({note.instrument for note in piece.notes}):
        is_drum = name in _DRUMS
        choices = _PROGRAMS.get(name, (0,))
        part = pretty_midi.Instrument(0 if is_drum else int(rng.choice(choices)), is_drum=is_drum, name=name)
        for note in (n for n in piece.notes if n.instrument == name):
            pitch = _DRUMS[name] if is_drum else int(np.clip(note.pitch, 0, 127))
            velocity = int(np.clip(round(127 * note.velocity), 1, 127))
            part.notes.append(pretty_midi.Note(velocity, pitch, note.start, note.start + note.duration))
        midi.instruments.append(part)
    midi.write(str(path))
