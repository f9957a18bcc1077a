"""Channels, tracks and levels: what an even mix would lose is heard, and one line says so."""

import logging
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.models.audio.sounds import encode, level_db, talk

from echoavatar.errors import AudioError
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.io import mixed

TALK, RATE = talk(48_000), 48_000
NOISE = np.random.default_rng(0).standard_normal((len(TALK), 8)).astype(np.float32)


@pytest.fixture(autouse=True)
def _warnings(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)


def heard(path: Path, channels: np.ndarray, subtype: str = "PCM_24") -> np.ndarray:
    soundfile.write(path / "a.wav", channels, RATE, subtype=subtype)
    return read_audio(path / "a.wav")


def said(caplog: pytest.LogCaptureFixture) -> str:
    """The one line."""
    (record,) = caplog.records
    assert "\n" not in record.getMessage()
    return record.getMessage()


OTHER = talk(48_000, 2.0)[::-1]
AB = np.where(np.arange(len(TALK)) < 0.75 * len(TALK), 1, 0).astype(np.float32)  # who speaks: three quarters, one
PAIRS = {
    "opposed": (np.stack([TALK, -TALK], 1), "opposed and would cancel"),
    "opposed, one softer": (np.stack([TALK, -0.7 * TALK], 1), "opposed and would cancel"),
    "opposed, with hiss": (np.stack([TALK, -TALK], 1) + 0.005 * NOISE[:, :2], "opposed and would cancel"),
    "opposed in one half": (np.stack([TALK, TALK * np.sign(AB - 0.5)], 1), "opposed and would cancel"),
    "left alone": (np.stack([TALK, 0 * TALK], 1), "FL alone"),
    "right alone, hiss on the left": (np.stack([1e-4 * NOISE[:, 0], TALK], 1), "FR alone"),
}


@pytest.mark.parametrize("what", PAIRS)
def test_stereo_that_an_even_mix_would_lose_keeps_its_level(
    tmp_path: Path, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    channels, line = PAIRS[what]
    assert level_db(heard(tmp_path, channels)) == pytest.approx(level_db(TALK), abs=1)
    assert line in said(caplog)


@pytest.mark.parametrize("second", [TALK, 0.8 * TALK, np.roll(TALK, 20)], ids=["the same", "a little softer", "late"])
def test_ordinary_stereo_is_mixed_evenly_and_nothing_is_said(
    tmp_path: Path, second: np.ndarray, caplog: pytest.LogCaptureFixture
) -> None:
    sound = heard(tmp_path, np.stack([TALK, second], 1))
    assert np.allclose(sound, heard(tmp_path, (TALK + second) / 2), atol=2e-3)
    assert not caplog.records


def test_two_speakers_on_two_sides_are_both_heard(tmp_path: Path) -> None:
    """One who speaks for a quarter of the time is not taken for a channel that may be left out."""
    sound = heard(tmp_path, np.stack([TALK * AB, OTHER * (1 - AB)], 1))
    cut = int(0.75 * len(sound))
    assert level_db(sound[:cut]) == pytest.approx(level_db(TALK[: 2 * cut]), abs=2)
    assert level_db(sound[cut:]) == pytest.approx(level_db(OTHER[2 * cut :]), abs=2)


LAYOUTS = {
    "3.0": 3, "quad": 4, "5.0": 5, "5.1": 6, "6.1": 7, "7.1": 8,
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("place", [0, 2, -1])
def test_speech_in_one_of_many_channels_loses_nothing(
    tmp_path: Path, layout: str, place: int, caplog: pytest.LogCaptureFixture
) -> None:
    """An even mix of 5.1 loses 15.6 dB."""
    channels = 1e-4 * NOISE[:, : LAYOUTS[layout]]
    channels[:, place] += TALK
    path = encode(tmp_path / "a.caf", "pcm_s24le", channels, RATE, layout=layout)
    assert level_db(read_audio(path)) == pytest.approx(level_db(TALK), abs=0.5)
    assert "alone holds the sound" in said(caplog)


@pytest.mark.parametrize("codec", ["ac3", "aac", "pcm_s16le"])
def test_a_films_speech_stands_before_its_music_and_its_rumble(tmp_path: Path, codec: str) -> None:
    """5.1: speech in the centre, music at a tenth of its level left and right, a rumble louder than both."""
    time = np.arange(len(TALK)) / RATE
    music, rumble = 0.02 * np.sin(2 * np.pi * 1_200 * time), 0.5 * np.sin(2 * np.pi * 40 * time)
    channels = np.stack([music, music, TALK, rumble, 0.3 * music, 0.3 * music], 1)
    path = encode(tmp_path / "a.mka", codec, channels, RATE, layout="5.1", bit_rate=384_000)
    spectrum = np.abs(np.fft.rfft(read_audio(path)[:48_000] * np.hanning(48_000))) / 12_000
    wanted = np.abs(np.fft.rfft(TALK[::2][:48_000] * np.hanning(48_000))) / 12_000
    at = {hertz: 20 * np.log10(spectrum[hertz * 2 - 20 : hertz * 2 + 20].max() + 1e-9) for hertz in (40, 440, 1_200)}
    assert at[440] == pytest.approx(20 * np.log10(wanted.max()), abs=2)
    assert at[440] - at[1_200] > 6
    assert at[440] - at[40] > 15


@pytest.mark.parametrize("channels", [2, 4, 6, 8, 40])
def test_channels_that_say_the_same_are_mixed_evenly(
    tmp_path: Path, channels: int, caplog: pytest.LogCaptureFixture
) -> None:
    assert level_db(heard(tmp_path, np.repeat(TALK[:, None], channels, 1))) == pytest.approx(level_db(TALK), abs=0.1)
    assert not caplog.records


@pytest.mark.parametrize(
    ("suffix", "codec"), [(".mp4", "aac"), (".mkv", "libopus"), (".mka", "pcm_s16le"), (".mov", "alac")]
)
@pytest.mark.parametrize("silence", [0.0, 1e-4])
def test_the_track_with_sound_is_taken(
    tmp_path: Path, suffix: str, codec: str, silence: float, caplog: pytest.LogCaptureFixture
) -> None:
    path = encode(tmp_path / f"a{suffix}", codec, [silence * NOISE[:, 0], TALK, TALK], RATE)
    assert level_db(read_audio(path)) == pytest.approx(level_db(TALK), abs=1)
    assert "first track is silent; track 2 is taken" in said(caplog)


def test_of_two_tracks_with_sound_the_first_is_taken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    sound = read_audio(encode(tmp_path / "a.mka", "pcm_s16le", [0.1 * TALK, TALK], RATE))
    assert level_db(sound) == pytest.approx(level_db(TALK) - 20, abs=0.5)
    assert not caplog.records


@pytest.mark.parametrize(("scale", "subtype"), [(6.0, "FLOAT"), (32_768.0, "FLOAT"), (2.0**31, "DOUBLE")])
def test_what_is_louder_than_1_is_brought_down(
    tmp_path: Path, scale: float, subtype: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A mix in floats goes over 1; integers that were saved as floats reach thousands."""
    sound = heard(tmp_path, scale * TALK, subtype)
    assert np.abs(sound).max() == pytest.approx(1, abs=0.02)
    assert "brought down to 1" in said(caplog)


def test_one_click_does_not_bring_the_level_down(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    clicked = TALK.copy()
    clicked[30_000] = 9
    assert level_db(heard(tmp_path, clicked, "FLOAT")[:14_000]) == pytest.approx(level_db(TALK[:28_000]), abs=0.5)
    assert not caplog.records
    clicked[30_000] = 1e6
    with pytest.raises(AudioError, match=r"audio sample 30000 \(0.625 s\) is 1e\+06"):
        heard(tmp_path, clicked, "FLOAT")


@pytest.mark.parametrize("level", [-50, -60, -70])
@pytest.mark.parametrize("channels", [1, 2])
def test_quiet_speech_is_lifted(tmp_path: Path, level: float, channels: int, caplog: pytest.LogCaptureFixture) -> None:
    quiet = TALK * 10 ** ((level - level_db(TALK)) / 20)
    sound = heard(tmp_path, np.repeat(quiet[:, None], channels, 1))
    assert -36 < level_db(sound) < -22
    assert "very quiet" in said(caplog)


@pytest.mark.parametrize("level", [-55, -75])
def test_the_noise_of_a_quiet_room_is_left_as_it_is(
    tmp_path: Path, level: float, caplog: pytest.LogCaptureFixture
) -> None:
    assert level_db(heard(tmp_path, 10 ** (level / 20) * NOISE[:, 0])) < level + 0.5
    assert not caplog.records


def test_a_silent_file_is_said_to_be_silent(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not heard(tmp_path, 0 * TALK).any()
    assert "it is silent" in said(caplog)


@pytest.mark.parametrize("offset", [0.4, -0.05])
@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_an_offset_is_taken_away(tmp_path: Path, offset: float, scale: float, caplog: pytest.LogCaptureFixture) -> None:
    sound = heard(tmp_path, np.stack([scale * TALK + offset] * 2, 1))
    assert abs(sound.mean()) < 1e-3
    assert level_db(sound) == pytest.approx(level_db(scale * TALK), abs=0.3)
    assert "off zero" in said(caplog)


@pytest.mark.parametrize("offset", [0.5, -0.01])
def test_nothing_but_an_offset_is_silence(tmp_path: Path, offset: float, caplog: pytest.LogCaptureFixture) -> None:
    assert level_db(heard(tmp_path, 0 * TALK + offset)) < -90
    assert "it is silent" in caplog.text


TIME = np.arange(len(TALK)) / RATE
STEADY = {
    "time code": 0.5 * np.sign(np.sin(2 * np.pi * 2_000 * TIME)),
    "hum": 0.3 * np.sin(2 * np.pi * 50 * TIME),
    "noise": 0.1 * NOISE[:, 1],
}


@pytest.mark.parametrize("what", STEADY)
@pytest.mark.parametrize("first", [True, False])
def test_a_channel_of_an_even_sound_beside_speech_is_left_out(
    tmp_path: Path, what: str, first: bool, caplog: pytest.LogCaptureFixture
) -> None:
    channels = [STEADY[what].astype(np.float32), TALK]
    sound = heard(tmp_path, np.stack(channels if first else channels[::-1], 1))
    assert np.allclose(sound, heard(tmp_path, TALK), atol=2e-3)
    assert "a channel of an even sound, such as time code or hum, is left out" in said(caplog)


def test_half_a_minute_of_silence_changes_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    sound = heard(tmp_path, np.concatenate([np.zeros(30 * RATE, np.float32), TALK]))
    assert level_db(sound[30 * 24_000 :]) == pytest.approx(level_db(TALK), abs=0.1)
    assert not caplog.records


def test_samples_are_measured_like_a_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    opposed = np.stack([TALK, -TALK], 1)
    for samples in (opposed, (opposed * 32_767).astype(np.int16)):
        assert level_db(mixed(samples, rate=RATE)) == pytest.approx(level_db(TALK), abs=0.1)
        assert "opposed" in said(caplog)
        caplog.clear()
    assert np.array_equal(mixed(TALK, rate=RATE), TALK)
    assert not len(mixed(TALK[:0], rate=RATE))


def test_each_part_of_a_pasted_file_has_its_own_mix(tmp_path: Path) -> None:
    first, second = tmp_path / "1.wav", tmp_path / "2.wav"
    soundfile.write(first, TALK, RATE)
    soundfile.write(second, np.stack([TALK, -TALK], 1), RATE)
    (tmp_path / "both.wav").write_bytes(first.read_bytes() + second.read_bytes())
    one, other = np.split(read_audio(tmp_path / "both.wav"), 2)
    assert level_db(one) == pytest.approx(level_db(other), abs=0.1)
