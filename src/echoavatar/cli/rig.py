"""`echoavatar rig`: measure a character's body on its own mesh, or write a map of its bones to complete."""

import argparse
import json
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import write_whole

from .batch import check_apart
from .options import MAP_HELP, local_path

EXAMPLES = """examples:
  echoavatar rig avatar.vrm -o avatar.json     measure a VRM character
  echoavatar rig character.glb -o body.json    measure a GLB
  echoavatar rig character.glb --template -o map.json     the bones that were found, null for the others: complete it,
  echoavatar rig character.glb --map map.json -o body.json     and use it, here or beside any other --rig or clip

The profile is JSON, and you may edit it: ellipsoids on the bones of spine, neck and head, and half the thickness of
palm and fingers, in metres. In a program: Pipeline(bundle, body=BodyProfile.load(path)).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("character", type=local_path, metavar="CHARACTER", help="rigged character, .glb, .vrm or .gltf")
    parser.add_argument("-o", "--output", type=Path, help="where to write, .json; without it --template prints")
    parser.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)
    parser.add_argument("--template", action="store_true", help="write a file for --map instead; reads clips as well")


def run(args: argparse.Namespace) -> int:
    """Read the character, measure it, write the profile and print its parts; or write the map of its bones."""
    if args.output is None and not args.template:
        raise EchoAvatarError("the profile needs a place: -o FILE.json")
    check_apart(args.output, character=args.character, map=args.map)
    if args.output is not None and not args.output.parent.is_dir():
        raise EchoAvatarError(f"cannot write {args.output}: {args.output.parent} is not a folder; make it first")
    from echoavatar.motion.formats.gltf_rig import read_skinned
    from echoavatar.motion.formats.joint_map import map_of, read_map
    from echoavatar.motion.ik import measure_body

    if args.template:
        return _write_map(map_of(args.character), args.output)
    skeleton, vertices, weights = read_skinned(args.character, read_map(args.map))
    profile = measure_body(skeleton, vertices, weights)
    profile.save(args.output)
    print(f"{'part':<12}{'width':>8}{'height':>8}{'depth':>8}  cm")
    for part in profile.parts:
        print(f"{part.bone:<12}" + "".join(f"{200 * radius:>8.1f}" for radius in part.radii))
    print(f"{args.output}: {len(profile.parts)} parts of {len(vertices)} vertices, {skeleton.joints} joints")
    return 0


def _write_map(found: dict[str, str | None], output: Path | None) -> int:
    text = json.dumps(found, indent=2, ensure_ascii=False) + "\n"
    if output is None:
        print(text, end="")
        return 0
    write_whole(output, text)
    missing = list(found.values()).count(None)
    print(f"{output}: {missing} of {len(found)} bones were not found; name their joints, then use --map {output}")
    return 0
