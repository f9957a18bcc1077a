"""A stranger's SDP offer becomes a short one, whatever is in it."""

import time

import pytest

pytest.importorskip("aiortc", reason="pip install 'echoavatar[video]'")

from aiortc.sdp import SessionDescription
from tests.server.video.webrtc import Watcher

from echoavatar.errors import EchoAvatarError
from echoavatar.server.video.offer import MOST_CANDIDATES, read_offer


async def offered() -> str:
    watcher = Watcher()
    text = await watcher.offer()
    await watcher.close()
    return text


def with_hosts(offer: str, hosts: list[str]) -> str:
    found = "".join(f"a=candidate:{n} 1 udp 7 {host} {20_000 + n} typ host\r\n" for n, host in enumerate(hosts))
    return offer.replace("a=candidate:", found + "a=candidate:", 1)


def hosts(offer: str) -> list[str]:
    return [each.ip for medium in SessionDescription.parse(offer).media for each in medium.ice_candidates]


async def test_what_is_needed_stays() -> None:
    offer = await offered()
    before, after = SessionDescription.parse(offer), SessionDescription.parse(read_offer(offer, "10.0.0.1"))
    for one, other in zip(before.media, after.media, strict=True):
        assert (one.kind, one.direction, one.rtp.muxId, one.dtls) == (
            other.kind,
            other.direction,
            other.rtp.muxId,
            other.dtls,
        )
        assert (one.ice.usernameFragment, one.ice.password) == (other.ice.usernameFragment, other.ice.password)
    assert hosts(offer) == hosts(read_offer(offer, "10.0.0.1"))
    assert [codec.mimeType for codec in after.media[1].rtp.codecs] == ["audio/opus"]


async def test_of_many_addresses_some_are_tried_and_no_name_is_looked_up() -> None:
    offer = await offered()
    many = [f"10.0.{number >> 8}.{number & 255}" for number in range(900)]
    assert hosts(read_offer(with_hosts(offer, many), "10.9.9.9")) == many[:MOST_CANDIDATES]
    names = [f"name{number}.local" for number in range(900)]
    assert hosts(read_offer(with_hosts(offer, names), "10.9.9.9")) == ["10.9.9.9"] * MOST_CANDIDATES
    others = hosts(read_offer(with_hosts(offer, ["evil.example", "localhost", "10.0.0.300"] * 300), "10.9.9.9"))
    assert others == hosts(offer)


async def test_what_is_too_long_is_refused_at_once() -> None:
    offer = await offered()
    began = time.monotonic()
    for text in (
        offer + "a=x\r\n" * 600,
        offer + f"a={'x' * 3_000}\r\n",
        offer + "m=audio 9 UDP/TLS/RTP/SAVPF 0\r\n" * 20,
    ):
        with pytest.raises(EchoAvatarError, match="the SDP offer has more than"):
            read_offer(text, "10.0.0.1")
    assert time.monotonic() - began < 1.0
