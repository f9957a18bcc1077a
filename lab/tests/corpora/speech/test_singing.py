import librosa
import numpy as np

from echoavatar_lab.corpora.speech.singing import sing


def test_a_voice_sings_notes_of_the_chord_on_the_beats() -> None:
    time = np.arange(12 * 24_000) / 24_000
    chord = sum(np.sin(2 * np.pi * 220 * 2 ** (step / 12) * time) for step in (0, 4, 7, 12)).astype(np.float32)
    voice, source = sing(0.1 * chord, np.arange(0.0, 12.0, 0.5), np.random.default_rng(0))
    assert (voice.shape, source.kind) == (chord.shape, "singing")
    assert np.abs(voice[: round((source.start - 0.1) * 24_000)]).max() < 0.01
    pitch = librosa.yin(voice, fmin=70, fmax=400, sr=24_000, frame_length=2048, hop_length=240)
    held = [pitch[at + 20 : at + 30] for at in range(0, 1100, 50) if voice[240 * (at + 20) :][:2400].std() > 0.05]
    steps = np.array([12 * np.log2(np.median(part) / 220) % 12 for part in held])
    off = np.abs(steps[:, None] - np.array([0, 4, 7, 12])[None]).min(1)
    assert len(steps) > 8
    assert np.mean(off < 0.5) > 0.8
