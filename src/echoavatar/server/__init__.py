"""The server of protocol `echoavatar.v1`: many clients, one engine. May import `files`, `engine` and below."""

from .app import create_app
from .run import serve
from .settings import ServerSettings

__all__ = ["ServerSettings", "create_app", "serve"]
