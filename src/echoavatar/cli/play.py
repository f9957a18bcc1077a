"""`echoavatar play`: play a recording into live sinks, to try a receiver without a server. No sound is played."""

import argparse
from contextlib import closing
from pathlib import Path

from .options import MAP_HELP, local_path

SINK_HELP = "show the motion at vmc://HOST[:PORT], livelink://HOST[:PORT] or json://HOST[:PORT]"
EXAMPLES = """examples:
  echoavatar animate talk.wav -o talk.npz
  echoavatar play talk.npz --sink vmc://127.0.0.1              VSeeFace, Warudo, Unity, Unreal, Blender
  echoavatar play talk.npz --sink livelink://192.168.1.7       the face of a MetaHuman
  echoavatar play talk.npz --sink 'vmc://127.0.0.1?rate=30&names=perfect' --loop
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("recording", type=local_path, metavar="RECORDING", help=".npz, .bvh, .glb, .vrm or .vrma")
    parser.add_argument("--sink", action="append", required=True, metavar="URL", help=f"{SINK_HELP}; repeat for more")
    parser.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)
    parser.add_argument("--loop", action="store_true", help="repeat until Ctrl-C")


def run(args: argparse.Namespace) -> int:
    """Play the recording."""
    from echoavatar.files.exports import read_take
    from echoavatar.motion.formats.joint_map import read_map
    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar.server.sinks import SinkGroup
    from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
    from echoavatar.wire.blobs import Pose
    from echoavatar.wire.messages import Rig

    take = read_take(args.recording, read_map(args.map)).on_humanoid().at(FRAME_RATE_HZ)
    motion = take.motion
    pose = Pose(motion.rotations, motion.root, take.face)
    config = HUMANOID.config
    rig = Rig(names=config.names, parents=config.parents, rest=config.offsets)
    rounds = 0
    with closing(SinkGroup(args.sink, rig)) as group:
        print(f"{args.recording}: {motion.seconds:.1f} s to {', '.join(args.sink)}", flush=True)
        while rounds == 0 or args.loop:
            group.put(rounds * len(pose.root) * SAMPLES_PER_FRAME, pose)
            group.finish()
            rounds += 1
        frames = [player.shown for player in group.players]
    print(f"frames shown: {', '.join(map(str, frames))}")
    return 0
