"""`echoavatar rig`: measure a character's body on its own mesh, so that hands do not pass into it."""

import argparse
from pathlib import Path

from echoavatar.errors import EchoAvatarError

EXAMPLES = """examples:
  echoavatar rig avatar.vrm -o avatar.json     measure a VRM character
  echoavatar rig character.glb -o body.json    measure a GLB with known joint names

The profile is JSON, and you may edit it: ellipsoids on the bones of spine, neck and head, and half the thickness of
palm and fingers, in metres. In a program: Pipeline(bundle, body=BodyProfile.load(path)).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument("character", type=Path, metavar="CHARACTER", help="rigged character, .glb, .vrm or .gltf")
    parser.add_argument("-o", "--output", type=Path, required=True, help="where to write the profile, .json")


def run(args: argparse.Namespace) -> int:
    """Read the character, measure it, write the profile and print its parts."""
    if not args.output.parent.is_dir():
        raise EchoAvatarError(f"cannot write {args.output}: {args.output.parent} is not a folder; make it first")
    from echoavatar.motion.formats.gltf_rig import read_skinned
    from echoavatar.motion.ik import measure_body

    skeleton, vertices, weights = read_skinned(args.character)
    profile = measure_body(skeleton, vertices, weights)
    profile.save(args.output)
    print(f"{'part':<12}{'width':>8}{'height':>8}{'depth':>8}  cm")
    for part in profile.parts:
        print(f"{part.bone:<12}" + "".join(f"{200 * radius:>8.1f}" for radius in part.radii))
    print(f"{args.output}: {len(profile.parts)} parts of {len(vertices)} vertices, {skeleton.joints} joints")
    return 0
