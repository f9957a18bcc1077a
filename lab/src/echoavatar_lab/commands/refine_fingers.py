"""`echoavatar refine-fingers`: adds fingers to motion that was captured without them."""

import argparse
from pathlib import Path

from echoavatar.cli.batch import check_apart
from echoavatar.cli.options import MAP_HELP, progress, seed
from echoavatar.errors import EchoAvatarError

EXAMPLES = """examples:
  echoavatar refine-fingers take.bvh take_fingers.bvh                  both hands, to match the arms
  echoavatar refine-fingers take.bvh out.bvh --hands frozen            only hands whose fingers do not move
  echoavatar refine-fingers take.bvh out.bvh --hands left --seed 3     the right hand is kept and taken into account
  echoavatar refine-fingers take.bvh out.bvh --model runs/fingers      a model of your own: `echoavatar train fingers`

Reads the skeleton of any person at any frame rate and writes the same
skeleton, frame rate and body; only rotations of finger bones change. The skeleton must have finger bones; some may be
missing.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("motion", type=Path, metavar="IN.bvh", help="motion with missing or bad fingers")
    parser.add_argument("output", type=Path, metavar="OUT.bvh", help="output with new fingers")
    parser.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)
    parser.add_argument("--model", type=Path, help="folder of a trained finger model (default: the shipped one)")
    parser.add_argument(
        "--hands",
        choices=("both", "left", "right", "frozen"),
        default="both",
        help="hands that get new fingers; frozen: those whose fingers do not move (default: %(default)s)",
    )
    parser.add_argument("--seed", type=seed, default=0, help="another seed gives other fingers (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Read, refine, write; print what changed."""
    if args.output.suffix.lower() != ".bvh":
        raise EchoAvatarError(f"cannot write {args.output}: the output must be BVH; name it OUT.bvh")
    check_apart(args.output, recording=args.motion)
    from echoavatar.motion.formats import write_bvh
    from echoavatar.motion.formats.bvh import read_standing
    from echoavatar.motion.formats.joint_map import read_map
    from echoavatar_lab.models.fingers.model import FingerModel, load_shipped
    from echoavatar_lab.models.fingers.refine import frozen_hands, refine_fingers

    motion, stand = read_standing(args.motion, read_map(args.map))
    frozen = frozen_hands(motion)
    model = FingerModel.load(args.model) if args.model else load_shipped()
    with progress(unit="step") as show:
        refined = refine_fingers(model, motion, hands=args.hands, seed=args.seed, progress=show)
    write_bvh(args.output, refined.skeleton, refined.rotations, refined.root, refined.fps, stand=stand)
    sides = frozen if args.hands == "frozen" else () if args.hands == "both" else (args.hands,)
    what = "no frozen hands, nothing changed" if refined is motion else ", ".join(sides) or "both hands"
    was = f" (frozen before: {', '.join(frozen)})" if frozen else ""
    print(f"{args.output}: {refined.frames} frames, {what}{was}")
    return 0
