"""`echoavatar mcp`: the tools of a running avatar, for agents that speak the Model Context Protocol."""

import argparse
import asyncio
import sys

from .options import add_server


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = (
        "examples:\n"
        "  echoavatar mcp                        over standard input and output; agents start this themselves\n"
        "  echoavatar mcp --http --port 8767     over streamable HTTP, at http://127.0.0.1:8767/mcp\n"
        "Calls act on a session of a running `echoavatar serve`: the newest, or --session.\n"
    )
    add_server(parser)
    parser.add_argument(
        "--session", default="", metavar="NAME", help="the session to act on, by its public name (default: the newest)"
    )
    parser.add_argument("--http", action="store_true", help="serve streamable HTTP instead of standard input")
    parser.add_argument("--host", default="127.0.0.1", help="with --http (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8767, help="with --http (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    from echoavatar.agents.client import RemoteTools
    from echoavatar.agents.mcp import serve_http, serve_stdio

    tools = RemoteTools(args.server, token=args.token, session=args.session)
    if args.http:
        print(f"echoavatar mcp is at http://{args.host}:{args.port}/mcp  (Ctrl-C stops)", file=sys.stderr)
        asyncio.run(serve_http(tools, host=args.host, port=args.port))
    else:
        asyncio.run(serve_stdio(tools))
    return 0
