"""Sound files, opened by their content: sounds that were concatenated in one file, their tracks, the decoded pieces.

All formats of ffmpeg's libraries (PyAV) that hold sound. A file name is never taken for a URL, and no file can make the
libraries read another one.
"""

import logging
import mmap
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import islice, pairwise
from math import lcm
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from av.codec import Codec
from av.codec.codec import UnknownCodecError
from av.container import InputContainer
from av.stream import Disposition
from jaxtyping import Float

from echoavatar.errors import AudioError
from echoavatar.limits import check_file

SOUND_SUFFIXES = (
    *(".wav", ".flac", ".mp3", ".ogg", ".opus", ".m4a", ".aac", ".aif", ".aifc", ".aiff", ".amr", ".au", ".caf"),
    *(".mka", ".oga", ".w64", ".weba", ".wma"),
)  # of files in a folder that are taken for sound; a file that is named may have any
# Containers that hold their own sound. ffmpeg's libraries also know playlists, concat lists, SDP and MPD. Those are
# texts that name other files or addresses, which would be opened.
_CONTAINERS = (
    "aac,ac3,aiff,amr,ape,asf,au,avi,avr,caf,dsf,dss,dts,eac3,flac,flv,g722,gsm,iff,ilbc,ircam,loas,matroska,webm,mlp"
    ",mov,mp4,3gp,3g2,mp3,mpeg,mpegts,mpc,mpc8,mxf,nistsphere,nut,oga,ogg,oma,opus,paf,pvf,qcp,rm,sbc,sox,tak,truehd"
    ",tta,voc,w64,wav,wv"
)
_OPTIONS = {"format_whitelist": _CONTAINERS, "protocol_whitelist": "file,subfile"}
_LARGEST_BYTES = 1 << 40
_PACKET = 4096  # bytes of a WAV that are decoded at once, rounded up to whole samples
_MOST_PARTS = 1_000  # of one file
_MOST_FAULTS = 100  # of a track, one after another
_STATE_LENGTH = ("aiff", "flac", "mov", "ogg")  # formats that state their length; of others FFmpeg guesses it
_GAP_S = (0.1, 3600.0)  # such a gap in the times of a track, or before the sound of a video, becomes silence
_BROKEN, _UNKNOWN = 0.95, 0.05  # shares of the stated length: with less a file breaks off, or states no real length
_BEGINS = {  # of files without an index, by their first four letters
    b"\x1aE\xdf\xa3": re.compile(rb"\x1aE\xdf\xa3.{1,60}?(?:webm|matroska)", re.DOTALL),
    b"FORM": re.compile(rb"FORM....AIF[FC]", re.DOTALL),
    b"RIFF": re.compile(rb"RIFF....WAVE(?=[A-Za-z]{3}[A-Za-z ])", re.DOTALL),
    b"fLaC": re.compile(rb"fLaC[\x00\x80]\x00\x00\x22"),
}
_STEREO, _SURROUND = ("FL", "FR"), ("FL", "FR", "FC", "LFE", "BL", "BR")
_USUAL_ROLES = {1: ("FC",), 2: _STEREO, 6: _SURROUND, 8: (*_SURROUND, "SL", "SR")}
_WAV_HEAD = re.compile(rb"fmt .\0\0\0(.{16})(?:.{8}(..))?", re.DOTALL)
_WIDTHS = {1: "pcm_u8", 2: "pcm_s16le", 3: "pcm_s24le", 4: "pcm_s32le"}  # by bytes of a sample
_NO_SOUND = {
    b"MThd": "is notes (MIDI) and no sound; play them into a WAV file, for example with FluidSynth",
    b"PK\x03\x04": "is a ZIP archive and no sound file; unpack it",
}
_XING = re.compile(rb"(?:Xing|Info)\0\0\0[\x03\x07\x0b\x0f].{4}(.{4})", re.DOTALL)  # of an MP3: its bytes
_FRAME = re.compile(rb"\xff[\xe0-\xff]")
_TAG = re.compile(rb"ID3[\x02-\x04]\0[\x00\x40\x80\xc0][\x00-\x7f]{4}")
_LOG = logging.getLogger(__name__)


class Form(NamedTuple):
    """The properties of sound that may change within a file."""

    rate: int  # samples per second
    channels: tuple[str, ...]  # their roles, such as FL, FR, FC, LFE


class Piece(NamedTuple):
    """Some tens of milliseconds of one track."""

    track: int
    form: Form
    samples: Float[np.ndarray, "s c"]  # about -1..1


def check_sound(path: Path) -> None:
    """Check that a file holds sound, by decoding its first piece.

    Raises AudioError if there is nothing, a folder, no regular file, or no sound in it.
    """
    if path.is_dir():
        raise AudioError(f"{path} is a folder; name a sound file in it")
    try:
        check_file(path, _LARGEST_BYTES, AudioError)
    except FileNotFoundError:
        raise AudioError(f"{path} does not exist; check the path") from None
    if path.stat().st_size == 0:
        raise AudioError(f"{path} is empty (0 bytes); copy or record it again")
    next(decoded(path))


def sound_named(path: Path, suffixes: Sequence[str] = SOUND_SUFFIXES) -> Path | None:
    """The sound whose path without its suffix this is: .wav, .WAV and .Wav alike; None if there is none."""
    written = (form for suffix in suffixes for form in (suffix, suffix.upper(), suffix.title()))
    return next((found for form in written if (found := path.with_name(path.name + form)).is_file()), None)


def open_sound(path: Path, part: range | None = None) -> InputContainer:
    """Open a sound or video file, or the bytes `part` of it; raises av.FFmpegError if it holds no sound of its own."""
    # Without `file:`, FFmpeg takes 10:30.wav for an address, and reads x.wav for file:x.wav.
    address = f"subfile,,start,{part.start},end,{part.stop},,:file:{path}" if part else f"file:{path}"
    options = _OPTIONS | {"codec_whitelist": _sound_decoders()}
    wav = _wav_form(_head(path, part.start if part else 0))
    if wav and wav[0] != wav[1]:  # FFmpeg would cut samples
        whole = lcm(wav[0], wav[1] or 1)
        options["max_size"] = str(-(-_PACKET // whole) * whole)
    opened: InputContainer = av.open(address, "r", metadata_errors="ignore", options=options)
    return opened


@lru_cache(maxsize=1)
def _sound_decoders() -> str:
    """Names of the sound decoders. Otherwise FFmpeg would decode a cover picture, too, whatever memory that takes."""
    found = []
    for name in av.codecs_available:
        with suppress(UnknownCodecError):  # it only encodes
            found += [name] if Codec(name, "r").type == "audio" else []
    return ",".join(found)


def decoded(path: Path, track: int | None = None, *, is_told: bool = False) -> Iterator[Piece]:
    """All pieces of one track, or of every track as they come; damage is skipped, and with `is_told` logged.

    Raises AudioError if it is not sound, has no track of sound, or cannot be read.
    """
    parts, piece = _parts(path), None
    failure = "holds no sound that can be decoded (no samples, or an unknown codec)"
    for number, part in enumerate(parts):
        try:
            with open_sound(path, part if part.start or len(parts) > 1 else None) as container:
                if not container.streams.audio:
                    raise AudioError(f"{path} has no sound track; choose a file with sound")
                for piece in _pieces(container, path, part, track, is_told):
                    yield piece
        except av.FFmpegError as error:
            if len(parts) == 1:
                failure = f"is not a sound file that ffmpeg's libraries can read ({error.strerror})"
            elif is_told:
                _LOG.warning("%s: part %d cannot be read (%s) and is left out", path, number + 1, error.strerror)
    if piece is None:
        raise AudioError(f"{path} {_what_it_is(path, failure)}")


def _pieces(container: InputContainer, path: Path, part: range, track: int | None, is_told: bool) -> Iterator[Piece]:
    streams = _tracks(container)
    tracks = {stream.index: number for number, stream in enumerate(streams)}
    stated = [_stated_roles(stream) for stream in streams]
    wav = _wav_form(_head(path, part.start)) if container.format.name == "wav" else None
    decoders = {stream.index: _decoder(stream, wav[2] if wav else "") for stream in streams}
    if is_told and wav and wav[0] != wav[1]:
        _LOG.warning("%s: a sample of all channels is read as %d bytes, not %d as its header states", path, *wav[:2])
    converters: dict[tuple[int, Form], av.AudioResampler] = {}
    packets, faults, seconds, gaps = container.demux(streams), 0, 0.0, 0.0
    origin, ends = (container.start_time or 0) / av.time_base, dict[int, float]()  # ends: of what came of each track
    while faults <= _MOST_FAULTS:
        try:
            packet = next(packets, None)
            if packet is None:
                break
            number = tracks[packet.stream.index]
            frames = decoders[packet.stream.index].decode(packet) if track in (None, number) else []
        except av.FFmpegError as error:
            faults += 1
            if is_told and faults > (container.format.name == "mp3"):  # the first frame of a pasted MP3 may need others
                _LOG.warning("%s is damaged (%s); decoding what is there", path, error.strerror)
                is_told = False
            continue
        for frame in frames:
            assert isinstance(frame, av.AudioFrame)
            faults = 0
            form = Form(frame.sample_rate, _roles(frame.layout, stated[number]))
            # Packed samples: PyAV reads beyond the list of planes where there are more than eight.
            if (number, form) not in converters:
                converters[number, form] = av.AudioResampler("flt", frame.layout, frame.sample_rate)
            end = ends.get(number, origin if container.streams.video else frame.time) or 0.0
            gap = (end if frame.time is None else frame.time) - end
            if _GAP_S[0] < gap < _GAP_S[1]:
                gaps += gap if number in ends else 0
                seconds += 0 if number else gap
                yield from _silence(number, form, gap)
            ends[number] = end + gap + frame.samples / frame.sample_rate
            seconds += 0 if number else frame.samples / frame.sample_rate
            for converted in converters[number, form].resample(frame):
                yield Piece(number, form, converted.to_ndarray().reshape(converted.samples, -1))
    if is_told and gaps:
        _LOG.warning("%s: its times leave out %.1f s, which are taken for silence", path, gaps)
    if is_told and (share := _share(container, path, part, seconds)) < _BROKEN:
        _LOG.warning("%s breaks off: %.0f %% of what it announces is there", path, 100 * share)


def _silence(track: int, form: Form, seconds: float) -> Iterator[Piece]:
    count = round(seconds * form.rate)
    for start in range(0, count, form.rate):
        yield Piece(track, form, np.zeros((min(form.rate, count - start), len(form.channels)), np.float32))


def _tracks(container: InputContainer) -> list[av.AudioStream]:
    """The sound tracks, those that the file marks as default first."""
    return sorted(container.streams.audio, key=lambda stream: not stream.disposition & Disposition.default)


def _share(container: InputContainer, path: Path, part: range, seconds: float) -> float:
    """The share of the stated length that is there; 1 if none, or only a placeholder such as 2 GB, is stated."""
    first, share, head = _tracks(container)[0], 1.0, _head(path, part.start)
    if container.format.name == "wav":
        share = len(part) / (8 + int.from_bytes(head[4:8], "little"))
    elif container.format.name == "mp3":
        tag = _after_tag(head)
        if found := _XING.search(_head(path, part.start + tag)):
            share = (len(part) - tag) / max(1, int.from_bytes(found[1]))
    elif container.format.name.startswith("matroska") and container.duration and len(container.streams) == 1:
        share = seconds / (container.duration - (container.start_time or 0)) * av.time_base
    elif container.format.name.startswith(_STATE_LENGTH) and first.duration and first.time_base:
        share = seconds / float(first.duration * first.time_base)
    return share if share > _UNKNOWN else 1.0


def _head(path: Path, start: int = 0, length: int = 1024) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(length)


def _wav_form(head: bytes) -> tuple[int, int, str] | None:
    """Of a WAV of PCM samples: bytes of a sample of all channels, computed and stated, and the decoder of integers.

    Where bits and block align contradict each other, the bytes of a second decide. None for other files.
    """
    found = _WAV_HEAD.search(head) if head.startswith(b"RIFF") else None
    if found is None:
        return None
    kind, channels, rate, speed, align, bits = struct.unpack("<HHIIHH", found[1])
    kind = int.from_bytes(found[2] or b"", "little") if kind == 0xFFFE else kind
    if kind not in (1, 3) or not channels or not bits:  # neither whole numbers nor floats
        return None
    is_sure = speed == rate * align and align % channels == 0
    width = max(-(-bits // 8), align // channels if is_sure else 0)
    return width * channels, align, _WIDTHS.get(width, "") if kind == 1 else ""


def _decoder(stream: av.AudioStream, kind: str) -> Any:
    """The decoder of a track: `kind` if given, as FFmpeg takes 24 bits in 32 for the floats of an old program."""
    if not kind:
        return stream
    whole: Any = av.CodecContext.create(kind, "r")
    whole.sample_rate, whole.layout = stream.codec_context.sample_rate, stream.codec_context.layout
    return whole


def _stated_roles(stream: av.AudioStream) -> tuple[str, ...]:
    """The roles of a track's channels as its file orders them.

    If a file has a channel order of its own (CAF, MOV), PyAV frees that list once for each frame, which crashes the
    process. So the list is removed from the decoder, which then only counts the channels.
    """
    if (context := stream.codec_context) is None:  # an unknown codec
        return ()
    layout = context.layout
    roles = tuple(channel.name for channel in layout.channels)
    if re.search(r"channels \(|ambisonic", layout.name):
        context.layout = f"{len(roles)}C"
    return roles


def _roles(layout: av.AudioLayout, stated: tuple[str, ...]) -> tuple[str, ...]:
    """The roles of channels; where the file states none, those that WAV and FLAC have by default (`usual_roles`)."""
    roles = tuple(channel.name for channel in layout.channels)
    if set(roles) != {"NONE"}:
        return roles
    return stated if len(stated) == len(roles) and set(stated) != {"NONE"} else usual_roles(len(roles))


def usual_roles(channels: int) -> tuple[str, ...]:
    """The roles of this many channels where the file states none."""
    return _USUAL_ROLES.get(channels, ("NONE",) * channels)


def _parts(path: Path) -> list[range]:
    """The byte ranges of the sounds that were concatenated in a file; ffmpeg's readers end with the first."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        first = _after_tag(data)
        kind = data[first : first + 4]
        if kind == b"RIFX":  # FFmpeg would take its samples for those of RIFF
            raise AudioError(f"{path} is a WAV in the byte order of old computers (RIFX); convert it to WAV (RIFF)")
        if kind == b"OggS":
            begins = _ogg_begins(data, first)
        elif data[first + 4 : first + 8] == b"ftyp":
            begins = _mp4_begins(data, first)
        elif kind in _BEGINS:
            begins = map(re.Match[bytes].start, _BEGINS[kind].finditer(data, first))
        elif _FRAME.match(data, first):  # MP3 and AAC have no beginning, but tags with pictures may stand in between
            first, begins = 0, _tag_begins(data)
        else:
            return [range(len(data))]
        starts = sorted({first, *islice(begins, _MOST_PARTS)})
        return [range(start, end) for start, end in pairwise([*starts, len(data)])]


def _after_tag(data: mmap.mmap | bytes, at: int = 0) -> int:
    """Index of the first byte behind an ID3 tag at `at`, which may hold a large picture; `at` if there is none."""
    if not _TAG.match(data, at):
        return at
    return at + 10 + sum(byte << shift for byte, shift in zip(data[at + 6 : at + 10], (21, 14, 7, 0), strict=True))


def _tag_begins(data: mmap.mmap) -> Iterator[int]:
    """Indices at which one or several ID3 tags in a row begin."""
    end = -1
    for found in _TAG.finditer(data):
        if found.start() > end:
            yield found.start()
        end = max(end, _after_tag(data, found.start()))


def _ogg_begins(data: mmap.mmap, at: int) -> Iterator[int]:
    """Indices at which the links of a chained Ogg file begin: first pages of streams that follow other pages."""
    is_first = False
    while (at := data.find(b"OggS", at)) >= 0:
        was_first, is_first = is_first, bool(data[at + 5 : at + 6] > b"\1" and data[at + 5] & 2)
        if is_first and not was_first:
            yield at
        lengths = data[at + 27 : at + 27 + data[at + 26]] if at + 26 < len(data) else b""
        at += 27 + len(lengths) + sum(lengths)


def _mp4_begins(data: mmap.mmap, at: int) -> Iterator[int]:
    while len(head := data[at : at + 16]) == 16:
        if head[4:8] == b"ftyp":
            yield at
        size = int.from_bytes(head[:4]) if head[:4] != b"\0\0\0\1" else int.from_bytes(head[8:])
        if size < 8:  # 0: to the end
            return
        at += size


def _what_it_is(path: Path, failure: str) -> str:
    """The error of a file in which there is no sound: its kind, and the remedy."""
    begin = _head(path)
    if begin[:4] in _NO_SOUND:
        return _NO_SOUND[begin[:4]]
    text = begin.decode("utf-8", "replace").lstrip("\ufeff \t\r\n")
    if text.lower().startswith(("<!doctype html", "<html")):
        return "is not a sound file but a web page; download the sound itself"
    if not re.search(r"[\0-\x08\x0e-\x1a]", text) and text.count("\ufffd") < 2:  # one letter may be cut
        return f"is not a sound file but text ({' '.join(text[:60].split())!r}); download the sound itself"
    if not _head(path, length=1 << 20).strip(b"\0"):  # raw samples may begin with silence
        return "is not a sound file but zeros; copy it again, whole"
    if begin[4:8] == b"ftyp":
        return "is an MP4 that is cut off or damaged; copy it again, whole"
    if begin.startswith(b"\x1fC\xb6u") or begin[4:8] in (b"moof", b"sidx", b"styp"):
        return "is a later part of a recorded or sent sound; put the first part before it"
    remedy = "convert it to WAV (raw samples need their rate: ffmpeg -f s16le -ar 24000 -i IN OUT.wav)"
    return f"{failure}; record it anew, or {remedy}"
