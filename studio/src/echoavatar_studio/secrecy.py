"""Passwords and tokens, and the hashes that are stored of them.

Passwords are hashed by scrypt with a salt each. Tokens (invitations, sessions) are 256 random bits, for which a plain
hash is enough: nobody can sign in with what is in the store.
"""

import base64
import hashlib
import hmac
import re
import secrets

_COST = {"n": 1 << 15, "r": 8, "p": 3}
_MEMORY = 64 << 20
MIN_PASSWORD = 10


def new_token() -> str:
    """A secret of 256 bits, safe in URLs."""
    return secrets.token_urlsafe(32)


def new_name() -> str:
    """A random public name of 96 bits, which cannot be guessed."""
    return secrets.token_hex(12)


def is_name(text: object) -> bool:
    """Whether `new_name` could have made it. Names become parts of paths and addresses, so nothing else may pass."""
    return isinstance(text, str) and re.fullmatch("[0-9a-f]{24}", text) is not None


def hash_token(token: str) -> str:
    """The stored hash of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def hash_password(password: str) -> str:
    """The stored form of a password: cost, salt and hash."""
    salt = secrets.token_bytes(16)
    parts = [base64.b64encode(part).decode() for part in (salt, _scrypt(password, salt, **_COST))]
    return "$".join(["scrypt", *(str(_COST[name]) for name in ("n", "r", "p")), *parts])


def is_password(password: str, kept: str) -> bool:
    """Whether `kept` is the stored form of this password; takes equally long either way."""
    _, n, r, p, salt, wanted = kept.split("$")
    found = _scrypt(password, base64.b64decode(salt), n=int(n), r=int(r), p=int(p))
    return hmac.compare_digest(found, base64.b64decode(wanted))


def is_same(a: str, b: str) -> bool:
    """Compare secrets in constant time."""
    return hmac.compare_digest(a.encode("utf-8", "surrogatepass"), b.encode("utf-8", "surrogatepass"))


def _scrypt(password: str, salt: bytes, *, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode("utf-8", "surrogatepass"), salt=salt, n=n, r=r, p=p, dklen=32, maxmem=_MEMORY)
