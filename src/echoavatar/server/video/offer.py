"""Shortens a stranger's SDP offer, within limits, to the parts that are used here.

Candidates are counted before anything reads them, and no name in them is looked up. A browser hides its addresses
behind names of mDNS (`.local`), which only its own network can resolve. In their place stands the address that the
offer came from, which is right where no router lies between; elsewhere the browser's own checks reach the server first.
"""

from collections.abc import Iterator

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.wire.guard import ip_of

try:
    from aiortc.sdp import MediaDescription, SessionDescription
except ImportError as error:
    raise DependencyError("WebRTC needs aiortc; run: pip install 'echoavatar[video]'") from error

MOST_BYTES = 65_536
MOST_LINES = 512  # without candidates
MOST_LETTERS = 2_048  # in a line
MOST_MEDIA = 8
MOST_CANDIDATES = 32  # of all media together; further ones are dropped
MOST_EACH = 16  # formats and header extensions of a medium
CODECS = ("video/vp8", "video/h264", "video/rtx", "audio/opus")
_CANDIDATE, _END = "a=candidate:", "a=end-of-candidates"


def read_offer(text: str, address: str) -> str:
    """Shorten an SDP offer that came from `address`. It may take some milliseconds; call it in a thread.

    Raises EchoAvatarError if it is beyond a limit, and whatever aiortc's parser raises if it is no offer.
    """
    lines = list(_without_excess(text.splitlines(), address))
    if len(lines) > MOST_LINES + MOST_CANDIDATES or max(map(len, lines), default=0) > MOST_LETTERS:
        raise EchoAvatarError(f"the SDP offer has more than {MOST_LINES} lines or {MOST_LETTERS} letters in a line")
    if sum(line.startswith("m=") for line in lines) > MOST_MEDIA:
        raise EchoAvatarError(f"the SDP offer has more than {MOST_MEDIA} media")
    description = SessionDescription.parse("\r\n".join(lines) + "\r\n")
    names = [medium.rtp.muxId for medium in description.media]
    if not all(names) or len(set(names)) < len(names):  # aiortc finds out when it connects
        raise EchoAvatarError("the SDP offer does not name each medium by a `mid` of its own")
    description.type = "offer"
    for medium in description.media:
        _shorten(medium)
    return str(description)


def _without_excess(lines: list[str], address: str) -> Iterator[str]:
    """All lines but candidates that are of no use, or too many."""
    seen = set[tuple[str, str]]()
    for line in lines:
        if not line.startswith(_CANDIDATE):
            if not line.startswith(_END):  # the browser's checks may bring more
                yield line
            continue
        parts = line[:MOST_LETTERS].split()
        if len(parts) < 8 or parts[1] != "1" or parts[2].lower() != "udp":
            continue
        if parts[4].endswith(".local"):
            parts[4] = address
        if len(seen) < MOST_CANDIDATES and (parts[4], parts[5]) not in seen and ip_of(parts[4]):
            seen.add((parts[4], parts[5]))
            yield " ".join(parts[:8])


def _shorten(medium: MediaDescription) -> None:
    """Leave out formats that the server does not send, and what is not needed to answer."""
    kept = [codec for codec in medium.rtp.codecs if codec.mimeType.lower() in CODECS][:MOST_EACH]
    if kept:
        medium.rtp.codecs, medium.fmt = kept, [codec.payloadType for codec in kept]
    medium.rtp.headerExtensions = medium.rtp.headerExtensions[:MOST_EACH]
    medium.ssrc, medium.ssrc_group = [], []
