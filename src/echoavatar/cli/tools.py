"""`echoavatar tools`: prints the avatar's tools as a language model's framework declares them."""

import argparse
import json
from pathlib import Path
from typing import cast, get_args

from .options import add_model

FORMS = ("openai", "openai-chat", "gemini", "anthropic", "elevenlabs", "pipecat", "livekit", "mcp", "plain")
EXAMPLES = """examples:
  echoavatar tools --format openai                 for session.update of the Realtime API, and Responses
  echoavatar tools --format gemini > tools.json
A running server returns the same at /v1/tools?style=openai, with its own music.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--format", choices=FORMS, default="openai", help="framework (default: %(default)s)")
    add_model(parser)
    parser.add_argument("--music", type=Path, metavar="FOLDER", help="more tracks for play_music")


def run(args: argparse.Namespace) -> int:
    """Print the tools as JSON."""
    from echoavatar.engine.music import Tracks
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar.engine.tools import Style, Toolbox

    assert set(FORMS) == set(get_args(Style))
    bundle = load_bundle(args.model)
    toolbox = Toolbox(bundle.actions, Tracks(args.music), has_manner=bundle.sizes.manner)
    print(json.dumps(toolbox.schemas(cast(Style, args.format)), indent=2, ensure_ascii=False))
    return 0
