"""`echoavatar actions`: lists, adds and removes a bundle's actions; needs no training."""

import argparse
import shutil
from contextlib import AbstractContextManager, nullcontext
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import write_error

from . import command_module
from .options import MAP_HELP, add_model

if TYPE_CHECKING:
    from echoavatar.engine.pipeline.actions import ActionLibrary
    from echoavatar.timing import ChunkSize

EXAMPLES = """examples:
  echoavatar actions list
  echoavatar actions add salute salute.bvh --about "salute like a soldier"   to a copy of the model, my-default
  echoavatar actions remove salute --model my-bundle
  echoavatar actions build --model my-bundle     (the built-in actions, for another tokenizer)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    listing = kinds.add_parser("list", help="names, lengths and meanings")
    add = kinds.add_parser("add", help="make an action from a clip of 0.5 to 20 s on any humanoid rig")
    add.add_argument("name", help="letters, digits, underscores; replaces an action of the same name")
    add.add_argument("clip", type=Path, help="BVH or GLB; begins and ends standing at ease")
    add.add_argument("--animation", metavar="NAME", help="which animation of a GLB (default: the first)")
    add.add_argument(
        "--hold",
        type=float,
        nargs=2,
        metavar=("FROM", "TO"),
        help="seconds of the clip to repeat while the action is held (default: the middle half); in an imported "
        "bundle, whose actions are sets of codes, the seconds to take the codes from",
    )
    add.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)
    add.add_argument("--about", default="", help="description for language models")
    remove = kinds.add_parser("remove", help="remove an action")
    remove.add_argument("name", help="name of the action")
    build = kinds.add_parser("build", help="make the built-in actions for this bundle's tokenizer")
    for child in (listing, add, remove, build):
        add_model(
            child,
            "folder of a bundle, or the name of a shipped one, which is copied here as my-NAME before it is changed",
        )


def run(args: argparse.Namespace) -> int:
    """List or change a library. A shipped bundle is copied only once the change is known to succeed."""
    if args.kind == "list":
        return _list(args.model)
    with _readable(args.model) as folder:
        if not (folder / "tokenizer").is_dir():
            raise EchoAvatarError(
                f"{args.model} is not a bundle's folder; `echoavatar bundle` makes one, or copy the shipped one"
            )
        if args.kind != "build":
            library, what = {"add": _with, "remove": _without}[args.kind](args, folder)
    folder = _own(args.model)
    if args.kind == "build":
        return int(command_module("actions build").run(argparse.Namespace(model=folder)))
    library.save(folder)
    print(f"{what} {folder / 'actions.json'}")
    return 0


def _readable(model: str) -> AbstractContextManager[Path]:
    """The folder to read: the one that may be changed, or the shipped one if there is no copy yet."""
    from echoavatar.engine.pipeline import shipped

    if model not in shipped():
        return nullcontext(Path(model))
    own = Path(f"my-{model}")
    return nullcontext(own) if own.exists() else as_file(files("echoavatar") / "bundles" / model)


def _own(model: str) -> Path:
    """The folder that may be changed: of a shipped bundle a copy, made once in the current folder."""
    from echoavatar.engine.pipeline import shipped

    if model not in shipped():
        return Path(model)
    own, partial = Path(f"my-{model}"), Path(f".my-{model}.partial")
    if not own.exists():
        try:
            with as_file(files("echoavatar") / "bundles" / model) as folder:
                shutil.copytree(folder, partial, copy_function=shutil.copyfile, dirs_exist_ok=True)
            partial.chmod(0o755)  # the package may be read-only
            partial.replace(own)
        except OSError as error:
            raise write_error(own, error) from error
    print(f"{model} stays as it is; {own}, a copy in this folder, is changed: use it as --model {own}")
    return own


def _list(bundle: str) -> int:
    from echoavatar.engine.pipeline import load_bundle

    library = load_bundle(bundle).actions
    width = max((len(name) for name in library), default=0)
    for name, action in library.items():
        print(f"{name:{width}}  {action.seconds:4.1f} s  {action.about}")
    print(f"{len(library)} actions in {bundle}")
    return 0


def _with(args: argparse.Namespace, folder: Path) -> "tuple[ActionLibrary, str]":
    from echoavatar.engine.pipeline.action_making import action_from_motion, set_from_motion
    from echoavatar.engine.pipeline.bundle import Part
    from echoavatar.engine.pipeline.runtime import Runtime
    from echoavatar.files.exports import read_take
    from echoavatar.motion.formats.joint_map import read_map

    library, chunk = _library(folder)
    tokenizer, rig = Part("tokenizer", folder=folder / "tokenizer").clip_tokenizer(chunk), Runtime.load(folder).rig
    hold = None if args.hold is None else (args.hold[0], args.hold[1])
    clip, about = read_take(args.clip, read_map(args.map), args.animation).motion, args.about
    if rig is None:
        action = action_from_motion(tokenizer, args.name, clip, chunk=chunk, hold_s=hold, about=about)
    else:
        action = set_from_motion(tokenizer, rig, args.name, clip, chunk=chunk, hold_s=hold, about=about)
    return library.with_action(action), f"{action.name}: {action.seconds:.1f} s, {len(set(action.codes))} codes, in"


def _without(args: argparse.Namespace, folder: Path) -> "tuple[ActionLibrary, str]":
    from echoavatar.engine.pipeline.actions import ActionLibrary

    library, _ = _library(folder)
    gone = library.find(args.name)
    left = ActionLibrary({name: action for name, action in library.items() if action is not gone})
    return left, f"{gone.name} removed from"


def _library(folder: Path) -> "tuple[ActionLibrary, ChunkSize]":
    """A bundle's actions and its chunk size, without loading its generator."""
    from echoavatar.engine.pipeline.actions import ActionLibrary
    from echoavatar.models.generator import GeneratorConfig
    from echoavatar.stored import read_config
    from echoavatar.timing import ChunkSize

    config = read_config(folder / "generator", GeneratorConfig)
    chunk = ChunkSize(config.step)
    return ActionLibrary.load(folder, len(config.directed) * config.layout.motion_codes, chunk), chunk
