"""What is kept of secrets does not give them away, and still knows them."""

from echoavatar_studio import secrecy
from echoavatar_studio.secrecy import hash_password, hash_token, is_name, is_password, is_same, new_name, new_token


def test_passwords_are_known_again_and_salted():
    one, two = hash_password("correct horse"), hash_password("correct horse")
    assert one != two
    assert "horse" not in one
    assert is_password("correct horse", one)
    assert not is_password("correct horse ", one)
    assert one.split("$")[:4] == ["scrypt", "32768", "8", "3"]


def test_tokens_are_long_random_and_kept_as_hashes():
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(len(token) for token in tokens) >= 43  # 256 bits
    assert hash_token("a") != hash_token("b")
    assert len(new_name()) == 24


def test_comparison_takes_any_text():
    assert is_same("ü", "ü")
    assert not is_same("", "x")
    assert not is_same("\udc80", "x")  # a header that is no UTF-8


def test_secrets_are_compared_in_constant_time(monkeypatch):
    compared = []
    monkeypatch.setattr(secrecy.hmac, "compare_digest", lambda a, b: compared.append((a, b)) or a == b)
    assert is_same("secret", "secret")
    assert not is_password("guess", hash_password("correct horse"))
    assert len(compared) == 2


def test_only_names_of_ours_are_names():
    assert is_name(new_name())
    for name in ("", "..", "0" * 23, "0" * 25, "A" * 24, "0" * 24 + "\n", "\u0660" * 24, 7, None):
        assert not is_name(name)
