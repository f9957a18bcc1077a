"""`echoavatar mcp`: the tools of a running avatar, for agents that speak the Model Context Protocol."""

import argparse
import asyncio
import sys

from .options import add_repeated, add_server, choose_token

EXAMPLES = """examples:
  echoavatar mcp                        over standard input and output; agents start this themselves
  echoavatar mcp --http --port 8767     over streamable HTTP, at http://127.0.0.1:8767/mcp
Calls act on a session of a running `echoavatar serve`: the newest, or --session.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_server(parser)
    parser.add_argument(
        "--session", default="", metavar="NAME", help="the session to act on, by its public name (default: the newest)"
    )
    parser.add_argument("--http", action="store_true", help="serve streamable HTTP instead of standard input")
    parser.add_argument("--host", default="127.0.0.1", help="with --http, address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8767, help="with --http, port; 0: any free (default: %(default)s)")
    parser.add_argument(
        "--agent-token",
        metavar="TOKEN",
        help="with --http, token that agents must send; default: $ECHOAVATAR_AGENT_TOKEN, else none on this machine, a "
        "random one on a network",
    )
    add_repeated(parser, "--origin", "URL", "with --http, let pages of this host connect")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    from echoavatar.agents.client import RemoteTools
    from echoavatar.agents.mcp import serve_http, serve_stdio

    tools = RemoteTools(args.server, token=args.token, session=args.session)
    if args.http:
        token, is_made_up = choose_token(args.agent_token, args.host)
        shown = f"  token: {token}" if is_made_up else ""

        def ready(address: str) -> None:
            print(f"echoavatar mcp is at {address}/mcp{shown}  (Ctrl-C stops)", file=sys.stderr, flush=True)

        origins = tuple(origin.rstrip("/") for origin in args.origin)
        asyncio.run(serve_http(tools, host=args.host, port=args.port, token=token, origins=origins, on_ready=ready))
    else:
        asyncio.run(serve_stdio(tools))
    return 0
