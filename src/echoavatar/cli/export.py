"""`echoavatar export`: write recordings for another program, on our character or on the user's."""

import argparse
from pathlib import Path

from .batch import Batch, add_outputs, outputs
from .options import MAP_HELP, RIG_HELP, local_path

EXAMPLES = """examples:
  echoavatar say talk.wav -o talk.npz                  record a session of a running server
  echoavatar export talk.npz -o talk.vrma              for any VRM avatar
  echoavatar export talk.npz -o talk.usdz              the character with skeleton, shapes and animation
  echoavatar export talk.npz -o out.glb --rig me.vrm   your own character with the animation
  echoavatar export clip.bvh -o out.bvh --rig rig.bvh  captured motion on another skeleton
  echoavatar export *.npz -o out/ --format .vrma       each recording into a file of its name
  echoavatar export pack.glb --animation walk -o walk.bvh   one animation of a character

Recordings are .npz from `animate` or `say`, SMPL motion (.npz), or any BVH, GLB, VRM or VRMA of a person. A --map is
for the rig; without --rig, for the recording.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("recording", type=local_path, nargs="+", metavar="RECORDING", help=".npz, .bvh or .glb")
    parser.add_argument("--animation", metavar="NAME", help="which animation of a .glb (default: the first)")
    add_outputs(parser, "recordings")
    parser.add_argument("--rig", type=local_path, metavar="FILE", help=RIG_HELP)
    parser.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)


def run(args: argparse.Namespace) -> int:
    """Read each recording, retarget it, write it."""
    from echoavatar.files.exports import check_output, read_rig, read_take, write_take
    from echoavatar.files.exports.formats import SUFFIXES
    from echoavatar.motion.formats.joint_map import read_map

    others = {"rig": args.rig, "map": args.map}
    places = outputs(args.recording, args.output, args.format, known=SUFFIXES, kind="recording", **others)
    for output in places:
        check_output(output, has_rig=args.rig is not None)
    given = read_map(args.map)
    rig = None if args.rig is None else read_rig(args.rig, given)
    batch = Batch(len(places))
    for recording, output in zip(args.recording, places, strict=True):
        with batch.each(recording, output):
            take = read_take(recording, given if rig is None else None, args.animation)
            write_take(output, take, rig=rig)
            motion = take.motion
            print(f"{output}: {motion.frames} frames at {motion.fps:g} fps, {motion.seconds:.2f} s")
    return batch.end()
