"""`echoavatar proxy`: an avatar for any voice agent that speaks the OpenAI Realtime protocol."""

import argparse
import asyncio
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from echoavatar.errors import EchoAvatarError
from echoavatar.outgoing import redacted

from .options import TOKEN, add_model, add_repeated

if TYPE_CHECKING:
    from echoavatar.agents.proxy import ProxySettings

EXAMPLES = """examples:
  echoavatar proxy --upstream wss://api.openai.com/v1/realtime
  echoavatar proxy --upstream ws://127.0.0.1:8765/v1/realtime --avatar http://127.0.0.1:8764 --tools
Then give your agent ws://127.0.0.1:8766/v1 instead of wss://api.openai.com/v1; its key is passed on.
docs/integrations/openai_realtime.md lists the events that the proxy adds.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--upstream", required=True, metavar="URL", help="such as wss://api.openai.com/v1/realtime")
    parser.add_argument("--avatar", metavar="URL", help="a running `echoavatar serve` (default: start one)")
    parser.add_argument("--token", default="", help=f"token of that server; default ${TOKEN}")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8766, help="port; 0: any free one (default: %(default)s)")
    parser.add_argument(
        "--tools", action="store_true", help="offer gestures and music to the model, and carry out its calls"
    )
    parser.add_argument("--no-idle", action="store_true", help="send motion during speech only")
    add_repeated(parser, "--origin", "URL", "let pages of this host connect")
    add_model(parser, "bundle for the server that it starts")
    parser.add_argument("--seats", type=int, default=3, help="most conversations with an avatar (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Run the proxy until stopped."""
    from echoavatar.agents.proxy import ProxySettings

    settings = ProxySettings(
        args.upstream,
        token=args.token,
        tools=args.tools,
        idle=not args.no_idle,
        origins=tuple(origin.rstrip("/") for origin in args.origin),
    )
    with contextlib.ExitStack() as stack:
        own = args.avatar or stack.enter_context(own_server(args.model, args.seats, args.token))
        asyncio.run(_proxy(replace(settings, avatar=own), args.host, args.port))
    print("echoavatar: stopped", file=sys.stderr)
    return 0


async def _proxy(settings: "ProxySettings", host: str, port: int) -> None:
    from echoavatar.agents.proxy import Relay
    from echoavatar.wire.sockets import address_of

    relay = Relay(settings)
    where = f"ws://{address_of(host, await relay.start(host, port))}/v1/realtime"
    print(f"echoavatar proxy is at {where}  (avatar at {redacted(settings.avatar)}; Ctrl-C stops)", flush=True)
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # on Windows Ctrl-C raises instead
            loop.add_signal_handler(number, stopped.set)
    await stopped.wait()
    await relay.stop()


@contextlib.contextmanager
def own_server(model: str, seats: int, token: str) -> Iterator[str]:
    """Start a server in a process of its own, so that the engine's work cannot delay the voice."""
    command = [sys.executable, "-m", "echoavatar", "serve", "--port", "0", "--model", model]
    process = subprocess.Popen(
        [*command, "--seats", str(seats), "--drain", "1"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {TOKEN: token},
        start_new_session=True,  # Ctrl-C goes to this process only, which then stops the server
    )
    try:
        assert process.stdout is not None
        told = process.stdout.readline().split()
        if "at" not in told:
            raise EchoAvatarError(f"the avatar's server did not start; try `echoavatar serve --model {model}`")
        yield told[told.index("at") + 1].split("?")[0].rstrip("/")
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
