"""Protocol `echoavatar.v1`: encode and decode messages. May import `timing` and `errors`.

`messages` defines the messages, `codec` encodes them (MessagePack, or readable JSON), and `blobs` packs poses and
sound. `docs/protocol.md` explains the protocol. `guard` checks tokens, origins and certificates, and `sockets` bounds
the sockets of a server.
"""
