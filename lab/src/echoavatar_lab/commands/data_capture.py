"""`echoavatar data capture`: captured people as material for the synthetic corpus. May import everything below."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from echoavatar_lab.corpora.capture.library import CapturedClip

EXAMPLES = """examples:
  echoavatar data capture recordings -o library.npz        read, clean and keep every clip below recordings/
  echoavatar data rehearse --library library.npz --hours 2 -o corpus        a corpus whose bodies come from it

Which files are read: known captured sets by their folder's name (reactidle_mit, cmu_dance, cmu_gesture, accad_cc_by,
hifi_apache2, hifi_talk_apache2, mesh2motion_cc0, movebox_rocketbox_mit), and your own BVH in folders named after what
the body does:
  standing   idles, listens, shifts its weight: the body beneath everything that is not dance
  speech     talks
  gesture    signals, laughs, waves
  dance      dances
  action     anything else; kept, but not used for bodies
Beside the files may lie bad_spans.csv (file,start_s,end_s), stretches to cut out, and in or above the folder
manifest.csv (file,licence,use), whose licences go into the library; files that may not train weights are left out.
A gesture_units.csv there (file,start_s,end_s,height,concept,tempo) lists gestures that speech may make: in BVH as
above, or keyed by animators in VMD (MikuMikuDance) or qianim (Pepper), of which arms and fingers are used.

What happens to a file: it is cut, smoothed, retargeted to our rig, its feet are put on the floor and kept still, and it
is turned into choreography controls that start at the origin and face +Z. The table shows how alive each group is
(docs/metrics.md explains the columns).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("folder", type=Path, help="folder of BVH files, or a library to show")
    parser.add_argument("-o", "--output", type=Path, help="the library, an .npz file (default: show only)")
    parser.add_argument("--clips", action="store_true", help="one line per clip instead of one per group")


def run(args: argparse.Namespace) -> int:
    """Build the library, write it, and print its table."""
    from echoavatar_lab.corpora.capture.library import open_library, read_folder

    if args.folder.is_dir():
        with tqdm(unit="file", disable=None) as bar:
            library = read_folder(args.folder, progress=lambda _: bar.update())
    else:
        library = open_library(args.folder)
    if args.output:
        library.save(args.output)
    rows: dict[tuple[str, str], list[CapturedClip]] = {}
    for clip in library.clips:
        rows.setdefault((clip.kind, clip.name if args.clips else clip.group), []).append(clip)
    _print_table(rows)
    for source, licence in library.credits().items():
        print(f"{source}: {licence}")
    return 0


def _print_table(rows: "dict[tuple[str, str], list[CapturedClip]]") -> None:
    from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS

    print(f"{'kind':<10}{'clips':<24}{'seconds':>9}" + "".join(f"{name:>15}" for name in STATISTICS))
    for (kind, name), clips in sorted(rows.items()):
        seconds = sum(clip.seconds for clip in clips)
        print(f"{kind:<10}{name[:23]:<24}{seconds:>9.1f}" + "".join(f"{value:>15.2f}" for value in _alive(clips)))


def _alive(clips: "list[CapturedClip]") -> "list[float]":
    """Statistics of windows of 30 s: means over clips, weighted by length."""
    import numpy as np

    from echoavatar.motion.kinematics import HUMANOID, Motion
    from echoavatar.timing import FRAME_RATE_HZ
    from echoavatar_lab.corpora.solver import solve
    from echoavatar_lab.evaluation.measures import clip_statistics
    from echoavatar_lab.evaluation.table import weighted_mean

    motions = [Motion(HUMANOID, *solve(clip.controls), float(FRAME_RATE_HZ)) for clip in clips]
    weights = np.array([motion.frames for motion in motions], float)
    return [weighted_mean(column, weights) for column in np.array([clip_statistics(m) for m in motions]).T]
