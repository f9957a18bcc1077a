import socket

import numpy as np
import pytest
from tests.server.sinks.receiving import Receiver, random_frame

from echoavatar.server.sinks import Frame, UdpSink


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
