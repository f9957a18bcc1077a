"""`echoavatar elevenlabs setup`: create tools, prompt and sound format of an ElevenLabs agent through their API."""

import argparse
import json
import os
from pathlib import Path
from typing import Any

from echoavatar.errors import EchoAvatarError
from echoavatar.limits import read_text

EXAMPLES = """examples:
  echoavatar elevenlabs setup --dry-run                     (print the requests; needs no key and no network)
  echoavatar elevenlabs setup --name "My idol"              (needs ELEVENLABS_API_KEY)
  echoavatar elevenlabs setup --agent agent_01... --prompt prompt.txt --server http://127.0.0.1:8765
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-command."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    setup = kinds.add_parser("setup", help="create or update the tools and an agent that uses them")
    setup.add_argument("--agent", default="", metavar="ID", help="update this agent (default: the agent called --name)")
    setup.add_argument("--name", default="EchoAvatar", help="the agent's name (default: %(default)s)")
    setup.add_argument(
        "--persona", default="Echo", metavar="NAME", help="the character's name in the prompt (default: %(default)s)"
    )
    setup.add_argument("--surroundings", default="", metavar="TEXT", help="where the avatar stands, for the prompt")
    setup.add_argument("--prompt", type=Path, metavar="FILE", help="use this prompt instead")
    setup.add_argument("--first-message", default="", metavar="TEXT", help="the agent's first words (default: none)")
    setup.add_argument(
        "--output-format",
        default="pcm_16000",
        metavar="FORMAT",
        help="sound of the agent: pcm_ and a sample rate, which its audio interface needs too (default: %(default)s)",
    )
    where = setup.add_mutually_exclusive_group()
    where.add_argument("--model", default="default", help="bundle whose actions are offered (default: %(default)s)")
    where.add_argument("--server", metavar="URL", help="offer the actions and music of a running server instead")
    setup.add_argument("--token", default="", help="the server's token")
    setup.add_argument(
        "--base-url", default="", metavar="URL", help="address of their API, for other regions and tests"
    )
    setup.add_argument("--dry-run", action="store_true", help="print the requests as JSON without sending them")


def run(args: argparse.Namespace) -> int:
    """Create or update the agent."""
    from echoavatar.agents.integrations.elevenlabs_setup import BASE_URL, carry_out, make_plan
    from echoavatar.agents.integrations.tools import persona

    key = os.environ.get("ELEVENLABS_API_KEY", "")
    if not key and not args.dry_run:
        raise EchoAvatarError("ELEVENLABS_API_KEY is not set; make a key at elevenlabs.io, or use --dry-run")
    schemas = _schemas(args)
    prompt = (
        read_text(args.prompt, "give a text file as --prompt")
        if args.prompt
        else persona(*_names(schemas), name=args.persona, surroundings=args.surroundings)
    )
    plan = make_plan(
        schemas, prompt, name=args.name, first_message=args.first_message, output_format=args.output_format
    )
    if args.dry_run:
        print(json.dumps({"tools": plan.tools, "agent": plan.agent}, indent=2, ensure_ascii=False))
        return 0
    agent_id, done = carry_out(plan, api_key=key, agent_id=args.agent, base_url=args.base_url or BASE_URL)
    print("\n".join(done))
    print(f"agent {agent_id}: play it at sample_rate={args.output_format.removeprefix('pcm_')}")
    return 0


def _schemas(args: argparse.Namespace) -> list[dict[str, Any]]:
    if args.server:
        from echoavatar.agents.client import RemoteTools

        return RemoteTools(args.server, token=args.token).schemas()
    from echoavatar.engine.music import Tracks
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar.engine.tools import Toolbox

    bundle = load_bundle(args.model)
    return Toolbox(bundle.actions, Tracks(), has_manner=bundle.sizes.manner).schemas()


def _names(schemas: list[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """The actions and tracks that the schemas offer."""
    arguments = {name: known for schema in schemas for name, known in schema["parameters"]["properties"].items()}
    return arguments["action"]["enum"], arguments["title"].get("enum", [])
