"""`echoavatar export`: write a recording for another program, on our character or on the user's."""

import argparse
from pathlib import Path

from echoavatar.errors import EchoAvatarError

from .options import FORMATS, RIG_HELP, local_path

EXAMPLES = """examples:
  echoavatar say talk.wav -o talk.npz                  record a session of a running server
  echoavatar export talk.npz -o talk.vrma              for any VRM avatar
  echoavatar export talk.npz -o talk.usdz              the character with skeleton, shapes and animation
  echoavatar export talk.npz -o out.glb --rig me.vrm   your own character with the animation
  echoavatar export clip.bvh -o out.bvh --rig rig.bvh  captured motion on another skeleton
  echoavatar export pack.glb --animation walk -o walk.bvh   one animation of a character

Recordings are .npz from `animate` or `say`, or any BVH, GLB, VRM or VRMA with known joint names.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument("recording", type=local_path, metavar="RECORDING", help=".npz, .bvh or .glb")
    parser.add_argument("--animation", metavar="NAME", help="which one of a .glb (default: the first)")
    parser.add_argument("-o", "--output", type=Path, required=True, help=f"where to write; {FORMATS}")
    parser.add_argument("--rig", type=Path, metavar="FILE", help=RIG_HELP)


def run(args: argparse.Namespace) -> int:
    """Read the recording, retarget it, write it."""
    from echoavatar.files.exports import check_output, read_rig, read_take, write_take

    if args.output.resolve() == args.recording.resolve():
        raise EchoAvatarError(f"-o {args.output} is the recording itself; choose another name")
    check_output(args.output, has_rig=args.rig is not None)
    rig = None if args.rig is None else read_rig(args.rig)
    take = read_take(args.recording, args.animation)
    write_take(args.output, take, rig=rig)
    motion = take.motion
    print(f"{args.output}: {motion.frames} frames at {motion.fps:g} fps, {motion.seconds:.2f} s")
    return 0
