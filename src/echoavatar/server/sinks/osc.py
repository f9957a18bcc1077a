"""Open Sound Control for a sender: bundles of messages whose floats are written in place.

Building 110 messages sixty times a second would cost milliseconds. The bytes are built once, and each frame only
writes its numbers into them.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

LARGEST = 1400  # bytes of a datagram; fits an Ethernet frame with its headers
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)  # time tag: immediately


class Message(NamedTuple):
    """An address, at most one string or integer, then a number of floats."""

    address: str
    first: str | int | None
    floats: int


def padded(text: str) -> bytes:
    """A string in OSC's form: zero-terminated and padded to a multiple of four bytes."""
    raw = text.encode()
    return raw + b"\0" * (4 - len(raw) % 4)


def encoded(message: Message) -> bytes:
    """A message with all floats 0."""
    kinds, body = ",", b""
    if isinstance(message.first, str):
        kinds, body = ",s", padded(message.first)
    elif message.first is not None:
        kinds, body = ",i", struct.pack(">i", message.first)
    return padded(message.address) + padded(kinds + "f" * message.floats) + body + b"\0" * (4 * message.floats)


class Bundles:
    """Messages packed into as few bundles as possible, with the positions of their floats."""

    def __init__(self, messages: Sequence[Message], largest: int = LARGEST) -> None:
        self.packets: list[bytearray] = []
        self._slots: list[np.ndarray] = []
        packet, slots = bytearray(_BUNDLE), list[int]()
        for message in messages:
            data = encoded(message)
            if len(packet) + 4 + len(data) > largest and slots:
                self._keep(packet, slots)
                packet, slots = bytearray(_BUNDLE), []
            packet += struct.pack(">i", len(data)) + data
            end = len(packet) // 4
            slots += range(end - message.floats, end)
        self._keep(packet, slots)
        self._views = [np.frombuffer(packet, ">f4") for packet in self.packets]

    def _keep(self, packet: bytearray, slots: list[int]) -> None:
        self.packets.append(packet)
        self._slots.append(np.array(slots, np.intp))

    def fill(self, values: Float[np.ndarray, " n"]) -> list[bytearray]:
        """The packets with these floats, in the order of the messages."""
        start = 0
        for view, slots in zip(self._views, self._slots, strict=True):
            view[slots] = values[start : start + len(slots)]
            start += len(slots)
        return self.packets
