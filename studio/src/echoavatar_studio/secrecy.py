"""Passwords and tokens: what is secret, and what is kept of it.

Passwords go through scrypt with a salt of their own. Tokens (invitations, sessions) are 256 random bits, so a plain
hash of them is as good as it gets: whoever reads the store cannot use it to come in.
"""

import base64
import hashlib
import hmac
import secrets

_COST = {"n": 1 << 15, "r": 8, "p": 3}
_MEMORY = 64 << 20
MIN_PASSWORD = 10


def new_token() -> str:
    """A secret of 256 bits, fit for addresses."""
    return secrets.token_urlsafe(32)


def new_name() -> str:
    """A public name of 96 bits that tells nothing and cannot be guessed."""
    return secrets.token_hex(12)


def hash_token(token: str) -> str:
    """What is kept of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def hash_password(password: str) -> str:
    """What is kept of a password: cost, salt and hash."""
    salt = secrets.token_bytes(16)
    parts = [base64.b64encode(part).decode() for part in (salt, _scrypt(password, salt, **_COST))]
    return "$".join(["scrypt", *(str(_COST[name]) for name in ("n", "r", "p")), *parts])


def is_password(password: str, kept: str) -> bool:
    """Whether it is the password that `kept` was made of; takes equally long either way."""
    _, n, r, p, salt, wanted = kept.split("$")
    found = _scrypt(password, base64.b64decode(salt), n=int(n), r=int(r), p=int(p))
    return hmac.compare_digest(found, base64.b64decode(wanted))


def is_same(a: str, b: str) -> bool:
    """Compares secrets without telling by time how much of them was right."""
    return hmac.compare_digest(a.encode("utf-8", "surrogatepass"), b.encode("utf-8", "surrogatepass"))


def _scrypt(password: str, salt: bytes, *, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(
        password.encode("utf-8", "surrogatepass"), salt=salt, n=n, r=r, p=p, dklen=32, maxmem=_MEMORY
    )
