import pytest
from tests.server.sinks.receiving import RIG

from echoavatar.errors import EchoAvatarError
from echoavatar.server.sinks import make_sink, parse_address
from echoavatar.server.sinks.address import Address


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
