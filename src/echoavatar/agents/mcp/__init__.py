"""The avatar's tools over the Model Context Protocol. May import `client`, `wire`, `timing` and `errors`.

This is the only room that imports the package `mcp`, which implements the protocol.
"""

from .server import create_server, serve_http, serve_stdio

__all__ = ["create_server", "serve_http", "serve_stdio"]
