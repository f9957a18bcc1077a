import socket

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, Receiver, random_frame

from echoavatar.errors import EchoAvatarError
from echoavatar.server.sinks import Frame, UdpSink, make_sink, parse_address
from echoavatar.server.sinks.sink import Address


class Says:
    def __init__(self, *packets: bytes | bytearray) -> None:
        self.packets = packets

    def faces(self, curves: np.ndarray) -> np.ndarray:
        return curves

    def __call__(self, frame: Frame) -> tuple[bytes | bytearray, ...]:
        return self.packets


def test_datagrams_arrive_in_order() -> None:
    with Receiver() as receiver:
        sink = UdpSink(Says(b"one", bytearray(b"two")), "127.0.0.1", receiver.port, 60)
        sink.send(random_frame())
        assert [packet for _, packet in receiver.packets(2)] == [b"one", b"two"]
        sink.close()


def test_a_missing_receiver_is_no_error() -> None:
    with Receiver() as receiver:
        port = receiver.port
    sink = UdpSink(Says(b"x"), "127.0.0.1", port, 60)
    for _ in range(50):
        sink.send(random_frame())
    sink.close()


def test_a_full_network_drops_and_does_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    sink = UdpSink(Says(b"x", b"y"), "127.0.0.1", 9, 60)

    tried: list[bytes] = []

    class Full:
        def sendto(self, packet: bytes, _: object) -> None:
            tried.append(packet)
            raise BlockingIOError

        def close(self) -> None:
            pass

    whole: socket.socket = sink._socket
    whole.close()
    monkeypatch.setattr(sink, "_socket", Full())
    sink.send(random_frame())
    assert tried == [b"x", b"y"]


def test_ports_have_the_defaults_of_their_protocols() -> None:
    assert parse_address("vmc://127.0.0.1") == Address("vmc", "127.0.0.1", 39_539)
    assert parse_address("livelink://studio.local") == Address("livelink", "studio.local", 11_111)
    assert parse_address("unity://10.0.0.2") == Address("unity", "10.0.0.2", 12_346)
    assert parse_address("json://[::1]:99") == Address("json", "::1", 99)


def test_options_change_rate_and_names() -> None:
    sink = make_sink("vmc://127.0.0.1?rate=24&names=perfect", RIG)
    assert sink.rate == 24
    sink.close()
    sink = make_sink("livelink://127.0.0.1?subject=Ada", RIG)
    assert sink.rate == 60
    sink.close()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("127.0.0.1:39539", "no known kind"),
        ("osc://127.0.0.1", "no known kind"),
        ("vmc://", "HOST:PORT"),
        ("vmc://host:99999", "HOST:PORT"),
        ("vmc://host/path", "HOST:PORT"),
        ("vmc://[::1", "HOST:PORT"),
        ("vmc:host", "HOST:PORT"),
        ("vmc://127.0.0.1?names=mine", "vrm0"),
        ("vmc://127.0.0.1?rate=0", "between 1 and 240"),
        ("vmc://127.0.0.1?rate=fast", "between 1 and 240"),
        ("livelink://127.0.0.1?names=vrm0", "has no option 'names'"),
        ("unity://127.0.0.1", "a server of its own"),
        ("vmc://no-such-host.invalid", "cannot be resolved"),
    ],
)
def test_mistakes_are_named(text: str, complaint: str) -> None:
    with pytest.raises(EchoAvatarError, match=complaint):
        make_sink(text, RIG)
