import os
import shutil
import subprocess
from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.wire import guard
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.guard import Admission, check_certificate, check_origin, has_token, is_loopback, network_of
from echoavatar.wire.messages import CLOSE_CODES
from echoavatar.wire.rates import TokenGate


def test_the_token_may_stand_in_the_hello_or_in_the_header() -> None:
    assert has_token("", {})
    assert has_token("secret", {}, "secret")
    assert has_token("secret", {"authorization": "Bearer secret"})
    assert not has_token("secret", {"authorization": "Basic secret"})


@pytest.mark.parametrize("given", ["", "Secret", "secret ", "sécret", "\ud800"])
def test_a_wrong_token_is_refused(given: str) -> None:
    assert not has_token("secret", {}, given)
    with pytest.raises(ProtocolError) as caught:
        TokenGate("secret").check(given, {}, "192.0.2.1")
    assert CLOSE_CODES[caught.value.code] == 4401


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        (None, "127.0.0.1:8765"),
        ("http://127.0.0.1:8765", "127.0.0.1:8765"),
        ("http://localhost:5173", "127.0.0.1:8765"),
        ("http://[::1]:8765", "[::1]:8765"),
        ("http://192.168.1.5:8765", "192.168.1.5:8765"),
        ("https://avatar.example.org", "avatar.example.org"),
    ],
)
def test_known_pages_may_connect(origin: str | None, host: str) -> None:
    headers = {"host": host} | ({"origin": origin} if origin else {})
    check_origin(headers, ("https://avatar.example.org",))


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        ("https://evil.example", "127.0.0.1:8765"),
        ("http://evil.example:8765", "evil.example:8765"),  # a host name that someone pointed at this server
        ("http://localhost:8765", "192.168.1.5:8765"),
        ("http://192.168.1.6:8765", "192.168.1.5:8765"),
        ("null", "127.0.0.1:8765"),
        ("http://[::1", "127.0.0.1:8765"),
        ("", ""),
    ],
)
def test_other_pages_may_not(origin: str, host: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        check_origin({"host": host, "origin": origin}, ())
    assert CLOSE_CODES[caught.value.code] == 4403


def test_loopback() -> None:
    assert is_loopback("localhost")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("example.org")


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("203.0.113.7", "203.0.113.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::ffff:203.0.113.7", "203.0.113.7"),
        ("unix", "unix"),
    ],
)
def test_an_ipv6_network_counts_as_one_address(address, network):
    assert network_of(address) == network


def test_tokens_are_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = []
    monkeypatch.setattr(guard.hmac, "compare_digest", lambda a, b: compared.append((a, b)) or a == b)
    assert has_token("secret", {"authorization": "Bearer guess"}, "secret")
    assert compared == [(b"secret", b"guess"), (b"secret", b"secret")]


@pytest.mark.parametrize("fault", ["cut", "damaged key", "no certificate", "of another", "password"])
def test_a_certificate_that_cannot_be_used_is_one_line(
    certified: tuple[Path, Path], tmp_path: Path, fault: str
) -> None:
    certificate, key = (shutil.copy(path, tmp_path) for path in certified)
    match fault:
        case "cut":
            Path(certificate).write_text(Path(certificate).read_text()[:400] + "!" * 40)
        case "damaged key":
            Path(key).write_bytes(os.urandom(2_000))
        case "no certificate":
            shutil.copy(key, certificate)
        case "of another":
            words = ["openssl", "genpkey", "-algorithm", "RSA", "-out", key]
            subprocess.run(words, check=True, capture_output=True)
        case "password":
            words = ["openssl", "rsa", "-aes256", "-passout", "pass:secret", "-in", certified[1], "-out", key]
            subprocess.run(words, check=True, capture_output=True)
    with pytest.raises(EchoAvatarError, match="cannot be used") as caught:
        check_certificate(str(certificate), str(key))
    assert "\n" not in str(caught.value)


class Scope:
    cancel_called = False

    def cancel(self) -> None:
        self.cancel_called = True


def test_a_silent_connection_gives_way_and_one_that_said_hello_does_not() -> None:
    admission = Admission(2)
    first, second, third, fourth = (Scope() for _ in range(4))
    assert admission.enter(first, "a")
    assert admission.enter(second, "a")
    admission.greet(first)
    assert admission.enter(third, "b")
    assert (first.cancel_called, second.cancel_called) == (False, True)
    admission.greet(third)
    assert not admission.enter(fourth, "c")
    admission.leave(first)
    assert admission.enter(fourth, "c")
    assert len(admission) == 2


def test_the_address_with_the_most_silent_connections_gives_way() -> None:
    admission = Admission(3)
    alone, crowd = Scope(), [Scope() for _ in range(3)]
    admission.enter(alone, "alone")
    for scope in crowd:
        assert admission.enter(scope, "crowd")
    assert not alone.cancel_called
    assert [scope.cancel_called for scope in crowd] == [True, False, False]


def test_an_evicted_connection_cannot_keep_its_place_by_a_late_hello() -> None:
    admission = Admission(1)
    late, newcomer = Scope(), Scope()
    admission.enter(late, "a")
    admission.enter(newcomer, "b")
    admission.greet(late)
    admission.leave(late)
    assert len(admission) == 1


def test_one_address_does_not_take_all_places() -> None:
    admission = Admission(10, per_address=2)
    first, second, third, fourth = (Scope() for _ in range(4))
    assert admission.enter(first, "a")
    admission.greet(first)
    assert admission.enter(second, "a")
    assert admission.enter(third, "a")
    assert (first.cancel_called, second.cancel_called) == (False, True)  # its own silent one gives way
    admission.greet(third)
    assert not admission.enter(fourth, "a")
    assert admission.enter(fourth, "b")
    admission.leave(first)
    assert admission.enter(Scope(), "a")


def test_an_ipv6_network_is_one_address() -> None:
    admission = Admission(10, per_address=1)
    scope = Scope()
    assert admission.enter(scope, "2001:db8::1")
    admission.greet(scope)
    assert not admission.enter(Scope(), "2001:db8::2")
    assert admission.enter(Scope(), "2001:db8:0:1::2")
