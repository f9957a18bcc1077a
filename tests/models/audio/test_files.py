"""Files as people bring them: pasted, streamed, tagged, cut off, misnamed. Each is made here."""

import logging
import struct
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
import soundfile
from av.stream import Disposition
from tests.models.audio.sounds import encode, joined, level_db, tagged, talk, with_sizes

from echoavatar.errors import AudioError
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import sound_named

TWO = talk(24_000)


def is_talk(sound: np.ndarray, times: int = 1, *, tolerance_s: float = 0.1) -> None:
    """All of it, at its right speed and level: every copy has the pauses and the pitch of `talk`."""
    assert len(sound) / 24_000 == pytest.approx(2 * times, abs=tolerance_s * times)
    for copy in np.array_split(sound, times):
        assert level_db(copy) == pytest.approx(level_db(TWO), abs=3)
        spectrum = np.abs(np.fft.rfft(copy * np.hanning(len(copy))))
        assert np.argmax(spectrum) * 24_000 / len(copy) == pytest.approx(440, abs=3)


def stereo(rate: int) -> np.ndarray:
    return np.stack([talk(rate)] * 2, axis=1)


@pytest.mark.parametrize(
    ("suffix", "codec", "container"), [(".mp3", "libmp3lame", "mp3"), (".aac", "aac", "adts"), (".ts", "aac", "mpegts")]
)
@pytest.mark.parametrize(("rate", "layout"), [(48_000, "stereo"), (44_100, "stereo"), (24_000, "mono")])
def test_rate_and_channels_may_change_half_way(
    tmp_path: Path, suffix: str, codec: str, container: str, rate: int, layout: str
) -> None:
    first = encode(tmp_path / f"1{suffix}", codec, talk(44_100), 44_100, container=container)
    sound = stereo(rate) if layout == "stereo" else talk(rate)
    second = encode(tmp_path / f"2{suffix}", codec, sound, rate, layout=layout, container=container)
    is_talk(read_audio(joined(tmp_path / f"both{suffix}", first, second)), 2)


@pytest.mark.parametrize("rates", [(24_000, 44_100), (44_100, 48_000), (48_000, 44_100, 16_000, 48_000)])
def test_pieces_without_any_tag_are_told_apart_by_their_frames(tmp_path: Path, rates: tuple[int, ...]) -> None:
    """As text to speech sends MP3: frames and nothing else; here every other piece is stereo."""
    pieces = []
    for number, rate in enumerate(rates):
        sound, layout = (stereo(rate), "stereo") if number % 2 else (talk(rate), "mono")
        path, bare = tmp_path / f"{number}.mp3", {"write_xing": "0", "id3v2_version": "0"}
        pieces.append(encode(path, "libmp3lame", sound, rate, layout=layout, options=bare))
    is_talk(read_audio(joined(tmp_path / "all.mp3", *pieces)), len(rates))


def pair(folder: Path, kind: str) -> tuple[Path, Path]:
    """Two files of a kind, whose rates and channels differ."""
    first, second = folder / f"1.{kind}", folder / f"2.{kind}"
    if kind in ("opus", "m4a", "webm", "mka"):
        codec, container = {"opus": ("libopus", "ogg"), "m4a": ("aac", "mp4")}.get(kind, ("libopus", None))
        encode(first, codec, talk(48_000), 48_000, container=container)
        encode(second, codec, stereo(48_000), 48_000, layout="stereo", container=container)
    else:
        form = {"ogg": "OGG", "wav": "WAV", "flac": "FLAC", "aiff": "AIFF"}[kind]
        soundfile.write(first, talk(44_100), 44_100, format=form)
        soundfile.write(second, stereo(24_000), 24_000, format=form)
    return first, second


@pytest.mark.parametrize("kind", ["ogg", "opus", "wav", "flac", "aiff", "m4a", "webm", "mka"])
def test_files_pasted_together_are_heard_to_the_end(tmp_path: Path, kind: str) -> None:
    """Chained Ogg is a format of its own (radio streams); of the others `cat a b` makes it, for pieces of speech."""
    first, second = pair(tmp_path, kind)
    is_talk(read_audio(joined(tmp_path / f"both.{kind}", first, second, first)), 3)


def test_pasted_mp3_with_covers_and_equal_rates_is_whole_and_not_called_damaged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A cover between two pieces is half a megabyte of noise to a decoder of MP3."""
    pieces = [
        encode(tmp_path / f"{k}.mp3", "libmp3lame", talk(rate), rate) for k, rate in enumerate((44_100, 44_100, 22_050))
    ]
    tagged(pieces[1], 500_000)
    pieces[2].write_bytes(pieces[2].read_bytes() + b"TAG" + bytes(125))
    is_talk(read_audio(joined(tmp_path / "all.mp3", *pieces, pieces[0])), 4, tolerance_s=0.03)
    assert not caplog.records


def test_noise_before_an_mp3_is_passed_over(tmp_path: Path) -> None:
    sound = encode(tmp_path / "1.mp3", "libmp3lame", talk(44_100), 44_100).read_bytes()
    (tmp_path / "a.mp3").write_bytes(np.random.default_rng(0).bytes(3_000) + sound)
    is_talk(read_audio(tmp_path / "a.mp3"))


@pytest.mark.parametrize("sizes", [(0, 0), (0xFFFFFFFF, 0xFFFFFFFF), (36, 0), (0x7FFFFFFF, 0x7FFFFFDB)])
def test_a_wav_that_was_streamed_knows_no_length(
    tmp_path: Path, sizes: tuple[int, int], caplog: pytest.LogCaptureFixture
) -> None:
    soundfile.write(tmp_path / "a.wav", TWO, 24_000)
    is_talk(read_audio(with_sizes(tmp_path / "a.wav", *sizes)))
    is_talk(read_audio(joined(tmp_path / "b.wav", tmp_path / "a.wav", tmp_path / "a.wav")), 2)
    assert not caplog.records


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("used", [24, 20, 32])
def test_24_bits_in_32_are_whole_numbers(tmp_path: Path, channels: int, used: int) -> None:
    """FFmpeg takes them for floats of a program of the nineties."""
    head = struct.pack("<HHIIHH", 0xFFFE, channels, 24_000, 96_000 * channels, 4 * channels, 32)
    head += struct.pack("<HHI", 22, used, 0) + bytes.fromhex("0100000000001000800000aa00389b71")
    data = np.stack([TWO * 2.0**31] * channels, 1).astype("<i4").tobytes()
    (tmp_path / "a.wav").write_bytes(wav(head, data))
    is_talk(read_audio(tmp_path / "a.wav"))


def wav(format_: bytes, data: bytes) -> bytes:
    chunks = b"WAVEfmt " + struct.pack("<I", len(format_)) + format_ + b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(chunks)) + chunks


@pytest.mark.parametrize("extra", [b"", bytes(2)])
def test_24_bits_in_32_may_be_said_in_the_old_form(tmp_path: Path, extra: bytes) -> None:
    head = struct.pack("<HHIIHH", 1, 1, 24_000, 96_000, 4, 24) + extra
    (tmp_path / "a.wav").write_bytes(wav(head, (TWO * 2.0**31).astype("<i4").tobytes()))
    is_talk(read_audio(tmp_path / "a.wav"))


@pytest.mark.parametrize("align", [0, 1, 2, 3, 4, 6, 7, 8, 12, 100])
@pytest.mark.parametrize(("channels", "width"), [(1, 2), (1, 3), (2, 2), (2, 3), (3, 2), (3, 4)])
def test_a_wav_whose_block_align_is_wrong_is_read_by_its_bits(
    tmp_path: Path, channels: int, width: int, align: int, caplog: pytest.LogCaptureFixture
) -> None:
    whole = np.repeat(np.round(TWO * (2.0 ** (8 * width - 1) - 1)).astype("<i4"), channels)
    head = struct.pack("<HHIIHH", 1, channels, 24_000, 24_000 * channels * width, align, 8 * width)
    (tmp_path / "a.wav").write_bytes(wav(head, whole.view(np.uint8).reshape(-1, 4)[:, :width].tobytes()))
    is_talk(read_audio(tmp_path / "a.wav"))
    assert len(caplog.records) == caplog.text.count("as its header states") == (align != channels * width)


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
def test_a_sample_has_the_width_that_block_align_and_bytes_of_a_second_agree_on(tmp_path: Path, bits: int) -> None:
    head = struct.pack("<HHIIHH", 1, 2, 24_000, 24_000 * 8, 8, bits)
    (tmp_path / "a.wav").write_bytes(wav(head, np.repeat(TWO * 2.0**31, 2).astype("<i4").tobytes()))
    is_talk(read_audio(tmp_path / "a.wav"))


@pytest.mark.parametrize(
    ("form", "field", "skipped", "unknown"),
    [("AU", b".snd", 4, b"\xff" * 4), ("CAF", b"data", 0, b"\xff" * 8), ("FLAC", b"fLaC", 18, bytes(4))],
)
def test_other_streamed_files_know_no_length(
    tmp_path: Path, form: str, field: bytes, skipped: int, unknown: bytes
) -> None:
    soundfile.write(tmp_path / "a", TWO, 24_000, format=form)
    content = bytearray((tmp_path / "a").read_bytes())
    place = content.index(field) + 4 + skipped
    content[place : place + len(unknown)] = unknown
    (tmp_path / "a").write_bytes(content)
    is_talk(read_audio(tmp_path / "a"))


@pytest.mark.parametrize("kind", ["wav", "flac", "mp3", "ogg", "aac"])
def test_a_large_cover_before_the_sound_is_passed_over(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "aac":
        encode(path, "aac", talk(44_100), 44_100, container="adts")
    else:
        soundfile.write(path, TWO, 24_000, format=kind.upper())
    is_talk(read_audio(tagged(path, 3_000_000)))


SUBTYPES = [
    *(("WAV", kind) for kind in ("PCM_U8", "PCM_24", "PCM_32", "FLOAT", "DOUBLE", "ALAW", "ULAW", "GSM610")),
    *(("WAV", kind) for kind in ("MS_ADPCM", "IMA_ADPCM")),
    *(("AIFF", kind) for kind in ("PCM_24", "ULAW", "GSM610")),
    *(("CAF", "ALAC_16"), ("CAF", "PCM_24"), ("AU", "G721_32"), ("RF64", "PCM_16"), ("W64", "PCM_16")),
    *(("VOC", "PCM_16"), ("NIST", "PCM_16"), ("IRCAM", "PCM_16"), ("SVX", "PCM_16"), ("AVR", "PCM_16")),
]


@pytest.mark.parametrize(("form", "subtype"), SUBTYPES)
def test_number_formats_and_containers_of_studios_and_telephones(tmp_path: Path, form: str, subtype: str) -> None:
    rate = 8_000 if subtype in ("GSM610", "G721_32") else 24_000
    soundfile.write(tmp_path / "sound", talk(rate), rate, format=form, subtype=subtype)
    is_talk(read_audio(tmp_path / "sound"))


@pytest.mark.parametrize(
    ("suffix", "codec", "rate"),
    [
        (".amr", "libopencore_amrnb", 8_000),
        (".3gp", "libopencore_amrnb", 8_000),
        (".wma", "wmav2", 44_100),
        (".mov", "aac", 44_100),
        (".mp4", "aac", 48_000),
        (".mkv", "libopus", 48_000),
        (".avi", "libmp3lame", 44_100),
        (".flv", "aac", 44_100),
        (".g722", "g722", 16_000),
        (".ac3", "ac3", 48_000),
        (".wv", "wavpack", 44_100),
        (".tta", "tta", 44_100),
        (".sbc", "sbc", 44_100),
        (".wav", "pcm_s16le", 192_000),
    ],
)
def test_sound_of_telephones_films_and_windows(tmp_path: Path, suffix: str, codec: str, rate: int) -> None:
    is_talk(
        read_audio(
            encode(tmp_path / f"a{suffix}", codec, talk(rate), rate, bit_rate=12_200 if rate == 8_000 else 96_000)
        )
    )


@pytest.mark.parametrize("name", ["A.WAV", "a.Mp3", "none", "a.mp3", "a.m4a", "a.txt", "10:30.wav", "a%03d.wav", "-"])
@pytest.mark.parametrize("form", ["WAV", "MP3", "OGG", "FLAC"])
def test_a_file_is_read_by_its_content_whatever_it_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, form: str
) -> None:
    monkeypatch.chdir(tmp_path)
    soundfile.write((tmp_path / name).open("wb"), TWO, 24_000, format=form)
    is_talk(read_audio(name))


REFUSED: dict[str, tuple[Callable[[], bytes], str]] = {
    "an error of an API": (lambda: b'{"error": {"message": "quota exceeded"}}', "but text .*quota exceeded"),
    "a page": (lambda: b"\n<!DOCTYPE html>\n<html><title>404</title></html>", "but a web page"),
    "raw samples": (lambda: (TWO * 32_767).astype("<i2").tobytes(), "raw samples need their rate"),
    "an archive": (lambda: b"PK\3\4" + bytes(range(256)) * 20, "is a ZIP archive and no sound file; unpack it"),
    "samples of another byte order": (lambda: b"RIFX\0\0\1\0WAVEfmt " + bytes(200), "byte order of old computers"),
    "zeros": (lambda: bytes(5_000), "but zeros; copy it again"),
    "raw samples that begin with silence": (lambda: bytes(5_000) + bytes(range(1, 256)), "raw samples need their rate"),
    "notes": (lambda: b"MThd\0\0\0\6\0\0\0\1\0\x60MTrk\0\0\0\4\0\xff\x2f\0", r"notes \(MIDI\) and no sound; play them"),
    "a WAV without samples": (lambda: wav(struct.pack("<HHIIHH", 1, 1, 24_000, 48_000, 2, 16), b""), "no samples"),
    "a recorder's second blob": (lambda: b"\x1fC\xb6u\x01\xff\xff\xff" + bytes(range(99)), "put the first part before"),
    "a segment of a stream": (lambda: b"\0\0\0\x10moof\0\0\0\x08mfhd", "put the first part before"),
    "an MP4 without its end": (lambda: b"\0\0\0\x18ftypM4A \0\0\0\0M4A isom" + bytes(4_000), "cut off or damaged"),
}


@pytest.mark.parametrize("what", REFUSED)
@pytest.mark.parametrize("suffix", [".wav", ".mp3"])
def test_what_is_no_sound_is_one_line_that_says_what_it_is(tmp_path: Path, what: str, suffix: str) -> None:
    content, said = REFUSED[what]
    (tmp_path / f"a{suffix}").write_bytes(content())
    with pytest.raises(AudioError, match=said) as caught:
        read_audio(tmp_path / f"a{suffix}")
    assert "\n" not in str(caught.value)


def test_a_codec_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "a.wav", TWO, 24_000)
    content = bytearray((tmp_path / "a.wav").read_bytes())
    content[20:22] = b"\x34\x12"
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(AudioError, match="holds no sound that can be decoded"):
        read_audio(tmp_path / "a.wav")


@pytest.mark.parametrize("kind", ["wav", "aiff", "flac"])
def test_a_file_that_breaks_off_is_read_so_far_and_told(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    soundfile.write(tmp_path / f"a.{kind}", np.tile(TWO, 3), 24_000)
    whole = (tmp_path / f"a.{kind}").read_bytes()
    (tmp_path / f"a.{kind}").write_bytes(whole[: len(whole) // 2])
    assert 2.3 < len(read_audio(tmp_path / f"a.{kind}")) / 24_000 < 3.5
    (line,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert "breaks off" in line or "is damaged" in line


@pytest.mark.parametrize(("suffix", "codec"), [(".mp3", "libmp3lame"), (".webm", "libopus")])
def test_a_download_that_breaks_off_is_told_where_its_length_is_stated(
    tmp_path: Path, suffix: str, codec: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = encode(tmp_path / f"a{suffix}", codec, talk(48_000), 48_000)
    is_talk(read_audio(path))
    assert not caplog.text
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert 0.7 < len(read_audio(path)) / 24_000 < 1.3
    assert "breaks off" in caplog.text


@pytest.mark.parametrize(("suffix", "codec"), [(".webm", "libopus"), (".m4a", "alac")])
@pytest.mark.parametrize("lost", [0, 1], ids=["paused", "lost"])
def test_a_gap_in_the_times_of_a_track_is_silence(
    tmp_path: Path, suffix: str, codec: str, lost: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """As in the tracks that conferences record, while a microphone is off or the network loses packets."""
    encode(tmp_path / f"a{suffix}", codec, np.tile(talk(48_000), 2), 48_000)
    with av.open(str(tmp_path / f"a{suffix}")) as whole, av.open(str(tmp_path / f"b{suffix}"), "w") as gappy:
        written = gappy.add_stream_from_template(whole.streams.audio[0])
        for packet in whole.demux():
            if packet.dts is None or packet.time_base is None or packet.pts is None:
                continue
            second = float(packet.pts * packet.time_base)
            if lost and 1.7 < second < 2.7:
                continue
            packet.pts += round(0 if lost or second < 1.7 else 1 / packet.time_base)
            packet.dts, packet.stream = packet.pts, written
            gappy.mux(packet)
    heard = read_audio(tmp_path / f"b{suffix}")
    assert len(heard) / 24_000 == pytest.approx(4 if lost else 5, abs=0.05)
    assert np.abs(heard[42_500:63_500]).max() < 1e-3
    assert level_db(heard[65_000:]) > -25
    assert "its times leave out 1.0 s" in caplog.text
    assert "breaks off" not in caplog.text


@pytest.mark.parametrize(
    ("spoilt", "told"), [(slice(30_000, 30_001), "silence"), (slice(30_000, -1_000, 500), "breaks off")]
)
def test_pages_of_an_ogg_that_are_lost_are_told(
    tmp_path: Path, spoilt: slice, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = encode(tmp_path / "a.ogg", "libopus", np.tile(talk(48_000), 2), 48_000)
    whole = np.frombuffer(path.read_bytes(), np.uint8).copy()
    whole[spoilt] ^= 0xFF
    path.write_bytes(whole.tobytes())
    seconds = len(read_audio(path)) / 24_000
    assert told in caplog.text
    assert seconds == pytest.approx(4, abs=0.1) or told == "breaks off"


def test_a_pasted_part_that_cannot_be_read_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    soundfile.write(tmp_path / "a.wav", TWO, 24_000)
    stub = tmp_path / "stub"
    stub.write_bytes(b"RIFF\x24\0\0\0WAVEfmt ")
    is_talk(read_audio(joined(tmp_path / "b.wav", tmp_path / "a.wav", stub)))
    assert "part 2 cannot be read" in caplog.text


@pytest.mark.parametrize("samples", [1, 7, 240])
def test_a_handful_of_samples_is_sound(tmp_path: Path, samples: int) -> None:
    soundfile.write(tmp_path / "a.wav", TWO[3_000 : 3_000 + samples], 24_000)
    assert len(read_audio(tmp_path / "a.wav")) == samples


def test_sound_that_begins_late_in_a_film_keeps_its_place(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as film:
        picture, sound = film.add_stream("mpeg4", rate=25), film.add_stream("alac", rate=48_000, layout="mono")
        picture.width, picture.height, picture.pix_fmt = 64, 64, "yuv420p"
        for _ in range(75):
            film.mux(picture.encode(av.VideoFrame(64, 64, "yuv420p")))
        cut = av.AudioResampler("s16p", "mono", 48_000, 4_096)
        frame = av.AudioFrame.from_ndarray(talk(48_000)[None], format="fltp", layout="mono")
        frame.sample_rate, frame.pts = 48_000, 48_000
        for piece in [*cut.resample(frame), *cut.resample(None)]:
            film.mux(sound.encode(piece))
        film.mux([*picture.encode(None), *sound.encode(None)])
    heard = read_audio(tmp_path / "a.mp4")
    assert np.abs(heard[:23_900]).max() < 1e-3
    is_talk(heard[24_000:])


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
@pytest.mark.parametrize("chosen", [0, 1])
def test_of_several_tracks_the_one_that_players_play_is_read(tmp_path: Path, kind: str, chosen: int) -> None:
    """As the language of a film that is marked to be heard."""
    other = (0.1 * np.sin(np.arange(48_000) / 3)).astype(np.float32)
    with av.open(str(tmp_path / f"a.{kind}"), "w") as film:
        streams = [film.add_stream("alac", rate=24_000, layout="mono") for _ in range(2)]
        for number, stream in enumerate(streams):
            stream.disposition = Disposition.default if number == chosen else 0
        for number, stream in enumerate(streams):
            cut = av.AudioResampler("s16p", "mono", 24_000, 4_096)
            frame = av.AudioFrame.from_ndarray((TWO if number == chosen else other)[None], "fltp", "mono")
            frame.sample_rate = 24_000
            for piece in [*cut.resample(frame), *cut.resample(None)]:
                film.mux(stream.encode(piece))
            film.mux(stream.encode(None))
    is_talk(read_audio(tmp_path / f"a.{kind}"))


def test_a_sound_is_found_by_its_name_in_any_letters(tmp_path: Path) -> None:
    assert sound_named(tmp_path / "take.1") is None
    for name in ("take.1.Mp3", "take.1.WAV"):
        (tmp_path / name).touch()
        found = sound_named(tmp_path / "take.1")
        assert found is not None
        assert found.name == name
