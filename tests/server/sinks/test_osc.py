"""python-osc reads what we write."""

import numpy as np
import pytest

from echoavatar.server.sinks.osc import Bundles, Message, padded

osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
MESSAGES = [
    Message("/one", "a name", 3),
    Message("/two", 7, 0),
    Message("/three", None, 1),
    *[Message("/many/of/them", f"number {k}", 7) for k in range(60)],
]


def read(packets):  # type: ignore[no-untyped-def]
    return [message for packet in packets for message in osc_bundle.OscBundle(bytes(packet))]


def test_an_independent_reader_finds_every_message_with_its_numbers() -> None:
    values = np.random.default_rng(0).normal(size=sum(message.floats for message in MESSAGES))
    found = read(Bundles(MESSAGES).fill(values))
    assert [message.address for message in found] == [message.address for message in MESSAGES]
    floats = [x for message in found for x in message.params if isinstance(x, float)]
    np.testing.assert_allclose(floats, values, rtol=1e-6)
    firsts = [message.params[0] for message in found if message.params and not isinstance(message.params[0], float)]
    assert firsts == [message.first for message in MESSAGES if message.first is not None]


def test_packets_fit_an_ethernet_frame_and_are_filled_again() -> None:
    bundles = Bundles(MESSAGES)
    sizes = list(map(len, bundles.packets))
    assert max(sizes) <= 1_472  # of 1,500 bytes, beside the headers of IP and UDP
    assert len(sizes) == -(-sum(sizes) // 1_400)
    count = sum(message.floats for message in MESSAGES)
    bundles.fill(np.ones(count))
    floats = [x for m in read(bundles.fill(np.zeros(count))) for x in m.params if isinstance(x, float)]
    assert not any(floats)


@pytest.mark.parametrize(("text", "length"), [("", 4), ("abc", 4), ("abcd", 8)])
def test_strings_end_with_a_zero_on_a_border_of_four(text: str, length: int) -> None:
    assert padded(text) == text.encode() + b"\0" * (length - len(text))
