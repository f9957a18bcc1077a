"""The names of sound formats, and the samples in them."""

import numpy as np
import pytest

from echoavatar.agents.voice_formats import Decoder, is_file, named_format

# G.711: codes at both ends and in the middle, with their 16-bit samples
MU = {0x00: -32_124, 0x7F: 0, 0x80: 32_124, 0xFF: 0, 0xF0: 120, 0x70: -120}
A = {0xD5: 8, 0x55: -8, 0xAA: 32_256, 0x2A: -32_256, 0xC5: 264}


@pytest.mark.parametrize(
    ("name", "rate", "form"),
    [
        ("pcm16", None, ("pcm", 24_000)),
        ("pcm_16000", None, ("pcm", 16_000)),
        ("pcm_16000", 48_000, ("pcm", 48_000)),
        ("pcm16", "8000", ("pcm", 8_000)),
        ("pcm16", "fast", ("pcm", 24_000)),
        ("pcm16", 1e9, ("pcm", 24_000)),
        ("linear16", True, ("pcm", 24_000)),
        ("audio/PCMU", None, ("ulaw", 8_000)),
        ("pcm_mulaw", None, ("ulaw", 8_000)),
        ("MU_LAW", None, ("ulaw", 8_000)),
        ("\u00b5-law", None, ("ulaw", 8_000)),
        ("a_law", None, ("alaw", 8_000)),
        ("s16be", None, ("s16be", 8_000)),
        ("pcm audio", None, ("pcm", 24_000)),
        ("g711_alaw", [8_000], ("alaw", 8_000)),
        ("pcm_f32le", None, ("pcm_f32le", 8_000)),
        ("raw-16khz-16bit-mono-pcm", None, ("pcm", 16_000)),
        ("raw-22.05khz-16bit-mono-pcm", None, ("pcm", 22_050)),
        ("raw-8khz-8bit-mono-mulaw", None, ("ulaw", 8_000)),
        ("pcm_48k", None, ("pcm", 48_000)),
        ("audio/L16; rate=16000; channels=1", None, ("pcm", 16_000)),
        ("audio/L16;rate=48000;channels=2", None, ("audio/l16;rate=48000;channels=2", 48_000)),
        ("audio-24khz-16bit-stereo-pcm", None, ("audio-24khz-16bit-stereo-pcm", 24_000)),
        ("mp3_44100_128", None, ("mp3_44100_128", 44_100)),
    ],
)
def test_formats_have_many_names(name: str, rate: object, form: tuple[str, int]) -> None:
    assert named_format(name, rate) == form


def test_files_are_known_by_how_they_begin() -> None:
    assert is_file(b"RIFF\0\0\0\0WAVE")
    assert not is_file(bytes(100))


@pytest.mark.parametrize(("kind", "table"), [("ulaw", MU), ("alaw", A)])
def test_telephone_codes_are_those_of_the_standard(kind: str, table: dict[int, int]) -> None:
    made = Decoder(kind, 24_000).push(bytes(table))
    assert made.tolist() == list(table.values())


def test_pcm_may_be_cut_anywhere() -> None:
    samples = np.arange(-500, 500, dtype="<i2")
    decoder, data = Decoder(), samples.tobytes()
    parts = [decoder.push(data[start : start + 7]) for start in range(0, len(data), 7)]
    np.testing.assert_array_equal(np.concatenate(parts), samples)


def test_other_rates_come_to_24_khz_and_nothing_is_lost_at_the_end() -> None:
    tone = (10_000 * np.sin(2 * np.pi * 440 * np.arange(8_000) / 8_000)).astype("<i2")
    decoder = Decoder("pcm", 8_000)
    made = np.concatenate([decoder.push(tone.tobytes()), decoder.push(b"", is_last=True)])
    assert len(made) == 24_000
    expected = 10_000 * np.sin(2 * np.pi * 440 * np.arange(24_000) / 24_000)
    assert np.abs(made - expected)[500:-500].max() < 100
