"""An avatar behind somebody's agent: clients of a server, the Realtime proxy, framework bridges, MCP tools.

May import `server` and below.
"""
