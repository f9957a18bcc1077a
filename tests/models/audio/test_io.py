import logging

import av
import numpy as np
import pytest
import soundfile

from echoavatar.errors import AudioError
from echoavatar.models.audio import read_audio, stream_audio, write_wav


def tone(rate: int, seconds: float = 1.0) -> np.ndarray:
    return (0.3 * np.sin(2 * np.pi * 440 * np.arange(int(rate * seconds)) / rate)).astype(np.float32)


def encode(path, codec: str, rate: int = 44_100, seconds: float = 3.0) -> None:
    """Write a tone through ffmpeg's libraries."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, layout="mono")
        frame = av.AudioFrame.from_ndarray(tone(rate, seconds)[None], format="fltp", layout="mono")
        frame.sample_rate = rate
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)


@pytest.mark.parametrize("rate", [8_000, 16_000, 24_000, 96_000])
@pytest.mark.parametrize("channels", [1, 2, 6])
def test_wav_of_any_rate_and_channel_count(tmp_path, rate, channels):
    soundfile.write(tmp_path / "a.wav", np.repeat(tone(rate)[:, None], channels, 1), rate)
    audio = read_audio(tmp_path / "a.wav")
    assert audio.dtype == np.float32
    assert audio.shape == (24_000,)
    np.testing.assert_allclose(audio[2_000:-2_000], tone(24_000)[2_000:-2_000], atol=2e-3)


@pytest.mark.parametrize(("name", "codec"), [("a.mp3", "libmp3lame"), ("a.m4a", "aac"), ("a.ogg", "libopus")])
def test_compressed_formats(tmp_path, name, codec):
    encode(tmp_path / name, codec, rate=48_000)
    audio = read_audio(tmp_path / name)
    assert abs(len(audio) - 72_000) < 3_000
    assert np.sqrt(np.mean(audio[10_000:60_000] ** 2)) == pytest.approx(0.3 / np.sqrt(2), rel=0.1)


def test_streaming_gives_the_same_sound_in_pieces(tmp_path):
    encode(tmp_path / "a.mp3", "libmp3lame")
    pieces = list(stream_audio(tmp_path / "a.mp3"))
    assert len(pieces) > 20
    assert np.array_equal(np.concatenate(pieces), read_audio(tmp_path / "a.mp3"))


def test_a_truncated_mp3_is_read_as_far_as_it_goes(tmp_path):
    encode(tmp_path / "a.mp3", "libmp3lame")
    whole = (tmp_path / "a.mp3").read_bytes()
    (tmp_path / "b.mp3").write_bytes(whole[: len(whole) // 2 + 17])
    assert 24_000 < len(read_audio(tmp_path / "b.mp3")) < 48_000


def test_damage_in_the_middle_is_logged_and_skipped(tmp_path, caplog):
    encode(tmp_path / "a.mp3", "libmp3lame", seconds=5)
    data = bytearray((tmp_path / "a.mp3").read_bytes())
    data[20_000:24_000] = np.random.default_rng(0).bytes(4_000)
    (tmp_path / "b.mp3").write_bytes(bytes(data))
    with caplog.at_level(logging.WARNING):
        audio = read_audio(tmp_path / "b.mp3")
    assert len(audio) > 3 * 24_000
    assert any("b.mp3 is damaged" in record.getMessage() for record in caplog.records)


def make_video(path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)


def test_bad_files_are_one_clear_line(tmp_path):
    (tmp_path / "empty.wav").touch()
    (tmp_path / "text.wav").write_text("dear diary, today was a long day\n" * 50)
    make_video(tmp_path / "mute.mp4")
    soundfile.write(tmp_path / "none.wav", np.zeros(0, np.float32), 24_000)
    encode(tmp_path / "a.mp3", "libmp3lame")
    (tmp_path / "stub.mp3").write_bytes((tmp_path / "a.mp3").read_bytes()[:60])
    for name, reason in {
        "missing.wav": "does not exist",
        ".": "is a folder",
        "empty.wav": r"is empty \(0 bytes\)",
        "text.wav": "is not a sound file|holds no sound",
        "mute.mp4": "has no sound track",
        "none.wav": "holds no sound|is not a sound file",
        "stub.mp3": "holds no sound|is not a sound file",
    }.items():
        with pytest.raises(AudioError, match=reason) as caught:
            read_audio(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_float_wav_with_nan_names_the_place(tmp_path):
    audio = tone(24_000)
    audio[1_234] = np.nan
    soundfile.write(tmp_path / "nan.wav", audio, 24_000, subtype="FLOAT")
    with pytest.raises(AudioError, match=r"nan.wav: audio sample 1234 \(0.051 s\) is nan"):
        read_audio(tmp_path / "nan.wav")


def test_write_wav_round_trip(tmp_path):
    write_wav(tmp_path / "out.wav", tone(24_000))
    np.testing.assert_allclose(read_audio(tmp_path / "out.wav"), tone(24_000), atol=1e-4)


def test_unwritable_places_leave_nothing_behind(tmp_path):
    with pytest.raises(AudioError, match="cannot write .*nowhere/out.wav"):
        write_wav(tmp_path / "nowhere" / "out.wav", tone(24_000))
    (tmp_path / "out.wav").mkdir()
    with pytest.raises(AudioError, match="cannot write"):
        write_wav(tmp_path / "out.wav", tone(24_000))
    assert [path.name for path in tmp_path.iterdir()] == ["out.wav"]
