"""`echoavatar data`: make training data. May import everything below."""

import argparse
from pathlib import Path

from tqdm import tqdm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    rehearse = kinds.add_parser(
        "rehearse",
        help="the synthetic rehearsal corpus: speech, music and silence with motion made to fit",
        description="Make the synthetic rehearsal corpus. The same seed gives the same corpus on any machine that has "
        "the same speech engines; a stopped run continues where it was.",
        epilog="example: echoavatar data rehearse --hours 0.2 --seed 1 -o corpus --workers 2",
    )
    rehearse.add_argument("--hours", type=float, default=0.2, help="how much to make (default: %(default)s)")
    rehearse.add_argument(
        "--seed", type=int, default=0, help="everything follows from it (default: %(default)s)"
    )
    rehearse.add_argument(
        "-o", "--output", type=Path, default=Path("corpus"), help="folder (default: %(default)s)"
    )
    rehearse.add_argument("--library", type=Path, help="folder of recorded BVH clips to weave in")
    rehearse.add_argument(
        "--recordings", type=Path, help="folder of recorded audio; paths containing 'music' are danced to"
    )
    rehearse.add_argument(
        "--soundfont", type=Path, help="SF2 file: fluidsynth plays half of the music with it"
    )
    rehearse.add_argument("--workers", type=int, default=2, help="processes (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Make the corpus."""
    from ..rehearsal.corpus import Plan, rehearse

    plan = Plan(
        args.hours,
        args.seed,
        args.output,
        library=args.library,
        recordings=args.recordings,
        soundfont=args.soundfont,
    )
    with tqdm(total=plan.clips, unit="clip") as bar:
        made = rehearse(plan, workers=args.workers, progress=lambda done, _: bar.update(done - bar.n))
    print(f"{made} clips, {plan.clips * plan.clip_seconds / 3600:.2f} hours in {plan.folder}")
    return 0
