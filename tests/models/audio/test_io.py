import contextlib
import logging
import os

import av
import numpy as np
import pytest
import soundfile
import soxr
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar.errors import AudioError
from echoavatar.models.audio import StreamResampler, io, read_audio, stream_audio, write_wav
from echoavatar.models.audio.io import as_mono


def stream(samples: np.ndarray, rate: int, size: int) -> np.ndarray:
    resampler = StreamResampler(rate)
    parts = [resampler.push(samples[i : i + size]) for i in range(0, len(samples), size)]
    return np.concatenate([*parts, resampler.flush()])


@settings(max_examples=30, deadline=None)
@given(
    rate=st.sampled_from([8_000, 11_025, 16_000, 22_050, 24_000, 44_100, 48_000, 96_000]),
    samples=st.integers(0, 5_000),
    size=st.integers(1, 1_500),
)
def test_length_is_exact_after_flush(rate, samples, size):
    out = stream(np.zeros(samples, np.float32), rate, max(size, 50))
    assert abs(len(out) - samples * 24_000 / rate) <= 0.5


@pytest.mark.parametrize("rate", [8_000, 44_100, 96_000])
def test_any_chunking_equals_one_piece(rate):
    audio = np.random.default_rng(0).standard_normal(rate // 2).astype(np.float32) * 0.1
    whole = stream(audio, rate, len(audio))
    for size in (100, 777, 4_096):
        np.testing.assert_allclose(stream(audio, rate, size), whole, atol=2e-6)


@pytest.mark.parametrize("rate", [8_000, 44_100, 48_000])
def test_a_tone_keeps_its_pitch_phase_and_size(rate):
    """Outside witness: the 440 Hz sine itself, away from the ends."""
    tone = np.sin(2 * np.pi * 440 * np.arange(rate) / rate).astype(np.float32)
    wanted = np.sin(2 * np.pi * 440 * np.arange(24_000) / 24_000)
    np.testing.assert_allclose(stream(tone, rate, 1_000)[2_000:-2_000], wanted[2_000:-2_000], atol=2e-3)


def test_own_rate_passes_unchanged():
    audio = np.random.default_rng(0).standard_normal(1_000).astype(np.float32)
    assert np.array_equal(stream(audio, 24_000, 300), audio)


def test_integers_and_channels_are_scaled_and_averaged():
    assert as_mono(np.array([-32_768, 16_384], np.int16)).tolist() == [-1.0, 0.5]
    assert as_mono(np.array([0, 128, 192], np.uint8)).tolist() == [-1.0, 0.0, 0.5]
    assert as_mono(np.array([[-(2**31)], [2**30]], np.int32)).tolist() == [-1.0, 0.5]
    assert as_mono(np.array([[0.1, 0.3, 0.5, 0, 0, 0]], np.float64)).tolist() == pytest.approx([0.15])


def test_six_channels_at_96_khz_equal_their_mean():
    audio = np.random.default_rng(0).standard_normal((9_600, 6)).astype(np.float32) * 0.1
    wanted = soxr.resample(audio.mean(1), 96_000, 24_000)
    np.testing.assert_allclose(stream(audio, 96_000, 1_000), wanted, atol=1e-4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_numbers_are_named_by_their_place(value):
    """Sample 8,000 + 160 of a stream at 16 kHz is 0.510 s."""
    resampler, audio = StreamResampler(16_000), np.zeros((8_000, 2), np.float32)
    resampler.push(audio)
    audio[160, 1] = value
    with pytest.raises(AudioError, match=r"audio sample 8160 \(0.510 s\) is (nan|inf|-inf); replace"):
        resampler.push(audio)


def test_integers_disguised_as_floats_are_refused():
    with pytest.raises(AudioError, match="is 12000; floating-point audio lies in -1..1"):
        as_mono(np.array([0, 12_000.0]))


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        (np.zeros((2, 3, 4)), "audio of shape"),
        (np.zeros((2, 24_000)), "transpose it first"),
        (np.zeros(4, complex), "samples of type complex128"),
        (np.array(["a"]), "samples of type"),
    ],
)
def test_wrong_shapes_and_types_are_refused(samples, reason):
    with pytest.raises(AudioError, match=reason):
        as_mono(samples)


def test_wrong_rates_and_ended_streams_are_refused():
    with pytest.raises(AudioError, match="sample rate of 0 Hz"):
        StreamResampler(0)
    resampler = StreamResampler(8_000)
    resampler.flush()
    assert len(resampler.flush()) == 0
    with pytest.raises(AudioError, match="has ended"):
        resampler.push(np.zeros(10))


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
@pytest.mark.parametrize("channels", [1, 2, 6, 9, 40])
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


def hls(name: str) -> str:
    return f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{name}\n#EXT-X-ENDLIST\n"


SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=audio 5004 RTP/AVP 0\n"
MPD = (
    '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" mediaPresentationDuration="PT1S">'
    '<Period><AdaptationSet mimeType="audio/wav"><Representation id="1" bandwidth="1"><BaseURL>secret.wav</BaseURL>'
    "</Representation></AdaptationSet></Period></MPD>"
)
POINTERS = {
    "ffconcat": "ffconcat version 1.0\nfile secret.wav\n",
    "ffconcat below": "ffconcat version 1.0\nfile below/secret.wav\n",
    "hls": hls("secret.wav"),
    "hls in ts": hls("secret.ts"),
    "hls key": hls("secret.ts").replace("#EXTINF", '#EXT-X-KEY:METHOD=AES-128,URI="secret.wav"\n#EXTINF'),
    "sdp": SDP,
    "mpd": MPD,
    "asx": '<ASX version="3.0"><ENTRY><REF HREF="secret.wav"/></ENTRY></ASX>',
    "pls": "[playlist]\nFile1=secret.wav\nNumberOfEntries=1\n",
    "image list": "secret%03d.wav",
}


@pytest.mark.parametrize("text", POINTERS.values(), ids=POINTERS)
@pytest.mark.parametrize("suffix", [".wav", ".mp3", ".m3u8", ".ffconcat", ".sdp", ".mpd"])
def test_no_text_makes_another_file_be_read(tmp_path, text, suffix):
    """Playlists, concat lists and session descriptions name other files; whatever a file is called, none is opened."""
    (tmp_path / "below").mkdir()
    for place in (tmp_path, tmp_path / "below"):
        soundfile.write(place / "secret.wav", tone(24_000), 24_000)
    encode(tmp_path / "secret.ts", "aac", rate=48_000)
    (tmp_path / f"a{suffix}").write_text(text)
    with pytest.raises(AudioError):
        read_audio(tmp_path / f"a{suffix}")


def test_pipes_and_devices_are_refused_and_do_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe.wav")
    for path in (tmp_path / "pipe.wav", "/dev/zero"):
        with pytest.raises(AudioError, match="not a regular file"):
            read_audio(path)


def test_more_sound_than_can_be_held_is_refused(tmp_path, monkeypatch):
    """Silence packs well: an hour of it takes a few kilobytes as FLAC."""
    monkeypatch.setattr(io, "LONGEST_S", 2)
    soundfile.write(tmp_path / "a.flac", np.zeros(24_000 * 3, np.float32), 24_000)
    with pytest.raises(AudioError, match="more than"):
        read_audio(tmp_path / "a.flac")
    assert sum(map(len, stream_audio(tmp_path / "a.flac"))) == 72_000


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mkv", "aac"), ("a.webm", "libopus"), ("a.aac", "aac"), ("a.flac", "flac"), ("a.ts", "aac")]
)
def test_other_containers_of_sound(tmp_path, name, codec):
    with av.open(str(tmp_path / name), "w") as container:
        stream = container.add_stream(codec, rate=48_000, layout="mono")
        form = stream.codec_context.format.name
        sound = av.AudioResampler(format=form, layout="mono", rate=48_000, frame_size=stream.frame_size or 960)
        frame = av.AudioFrame.from_ndarray(tone(48_000)[None], format="fltp", layout="mono")
        frame.sample_rate = 48_000
        for piece in [*sound.resample(frame), *sound.resample(None)]:
            container.mux(stream.encode(piece))
        container.mux(stream.encode(None))
    assert len(read_audio(tmp_path / name)) == pytest.approx(24_000, abs=3_000)


@pytest.mark.parametrize(("name", "codec"), [("a.mp3", "libmp3lame"), ("a.m4a", "aac"), ("a.ogg", "libopus")])
def test_mutated_media_are_read_or_refused(tmp_path, name, codec):
    """Bits flipped, pieces cut out and repeated: sound that is finite, or one AudioError."""
    encode(tmp_path / name, codec, rate=48_000, seconds=0.5)
    whole, rng = (tmp_path / name).read_bytes(), np.random.default_rng(3)
    for number in range(40):
        data = bytearray(whole)
        at = int(rng.integers(len(data)))
        if number % 3 == 0:
            del data[at : at + int(rng.integers(1, 400))]
        elif number % 3 == 1:
            data[at:at] = data[at : at + int(rng.integers(1, 400))]
        for place in rng.integers(0, len(data), 1 + number % 8):
            data[place] ^= 1 << int(rng.integers(8))
        (tmp_path / f"b{name}").write_bytes(data)
        with contextlib.suppress(AudioError):
            assert np.isfinite(read_audio(tmp_path / f"b{name}")).all()


@pytest.mark.parametrize("name", ["10:30.wav", "file:a.wav", "pipe:0.wav", "concat:a.wav", "data:,x.wav"])
def test_a_name_with_a_colon_is_a_name_and_no_address(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    write_wav("a.wav", np.zeros(2_400, np.float32))
    write_wav(name, np.full(1_200, 0.5, np.float32))
    assert len(read_audio(name)) == 1_200
