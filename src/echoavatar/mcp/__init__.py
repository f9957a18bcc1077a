"""The avatar's tools over the Model Context Protocol. May import `client`, `wire`, `timing` and `errors`.

Named like the package `mcp` that does the protocol; the only room that imports it.
"""

from .server import create_server, serve_http, serve_stdio

__all__ = ["create_server", "serve_http", "serve_stdio"]
