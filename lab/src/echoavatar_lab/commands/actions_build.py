"""`echoavatar actions build`: makes the built-in actions for a bundle's tokenizer."""

import argparse
from pathlib import Path

from echoavatar.errors import EchoAvatarError


def run(args: argparse.Namespace) -> int:
    """Make the actions of `args.model`, a bundle's folder, and save them there."""
    from echoavatar.engine.pipeline.runtime import Runtime
    from echoavatar_lab.corpora.rehearsal.own_actions import own_actions
    from echoavatar_lab.models.tokenizer.model import BodyTokenizer

    folder = Path(args.model)
    if Runtime.load(folder).rig is not None:
        raise EchoAvatarError(
            f"{args.model} has another rig, for which the built-in actions cannot be made; add clips one by one with "
            "`echoavatar actions add`"
        )
    library = own_actions(BodyTokenizer.load(folder / "tokenizer").eval())
    library.save(folder)
    print(f"{len(library)} actions in {folder / 'actions.json'}")
    return 0
