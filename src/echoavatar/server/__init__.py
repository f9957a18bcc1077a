"""The server of protocol `echoavatar.v1`: many clients, one engine. May import `files`, `engine` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .app import create_app
    from .run import serve
    from .settings import ServerSettings

__all__ = ["ServerSettings", "create_app", "serve"]
_HOMES = {"ServerSettings": ".settings", "create_app": ".app", "serve": ".run"}


def __getattr__(name: str) -> object:
    """Import a name when it is first asked for: clients that use the sinks need no engine."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
