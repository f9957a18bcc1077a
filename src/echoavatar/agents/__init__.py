"""An avatar behind a voice agent: clients of a server, the Realtime proxy, framework bridges, MCP tools.

May import `server` and below.
"""
