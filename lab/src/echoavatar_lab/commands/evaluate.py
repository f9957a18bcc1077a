"""`echoavatar evaluate`: scores a bundle on held-out audio and motion. The last line is JSON."""

import argparse
import json
from pathlib import Path
from typing import Any

from echoavatar.cli.options import RUNTIME_HELP, count

EXAMPLES = """examples:
  echoavatar evaluate default                                        every score of a bundle, on clips made for it
  echoavatar evaluate default --corpus corpus --recordings sounds    on a corpus's test clips, and on real sound
  echoavatar evaluate default alive --recordings sounds --captured people --pictures alive.png
  echoavatar evaluate default jury --recordings sounds --captured people --judges others
  echoavatar evaluate default jury --motion corpus --captured people
  echoavatar evaluate default codes --corpus corpus --tokenizer runs/tokenizer
  echoavatar evaluate default domains --captured people
  echoavatar evaluate default people --captured data --card my-bundle/card.json
  echoavatar evaluate default drift --recordings sounds --minutes 10 --clips 4
`echoavatar evaluate BUNDLE MEASURE --help` explains one measure; what each row means: docs/metrics.md.
"""
CAPTURED_HELP = "folder of the named clips of captured people: our list, or its own people.csv (docs/metrics.md)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments, and the measures with their own."""
    parser.add_argument("model", metavar="BUNDLE", help="bundle name or folder")
    _shared(parser, "corpus", "clips", "recordings", "seconds", "repeats")
    parser.add_argument(
        "--beside",
        type=Path,
        action="append",
        default=[],
        metavar="GENERATOR",
        help="another generator of the same codes: only compare the audio reliance of both; may be repeated",
    )
    measures = parser.add_subparsers(
        dest="measure",
        metavar="MEASURE",
        title="measures",
        description="one thing instead of the whole table",
        prog=f"{parser.prog} BUNDLE",
    )
    parser.usage = "%(prog)s [options] BUNDLE [MEASURE [options]]"

    def measure(name: str, summary: str, *shared: str) -> argparse.ArgumentParser:
        child = measures.add_parser(name, help=summary, description=summary)
        _shared(child, *shared, is_measure=True)
        return child

    alive = measure(
        "alive",
        "how much the body moves and varies, beside people: --clips sounds each of speech and music from --recordings,"
        " silence and listening",
        *("clips", "recordings", "seconds", "repeats"),
    )
    alive.add_argument("--captured", type=Path, metavar="FOLDER", help=CAPTURED_HELP)
    alive.add_argument("--pictures", type=Path, metavar="PNG", help="write stills of each take, and a plot")
    alive.add_argument("--card", type=Path, metavar="JSON", help="also write the rows into this card.json of a bundle")
    jury = measure(
        "jury",
        "how the body moves, beside people's range, rows outside first: --clips sounds each of speech and music from"
        " --recordings",
        *("clips", "recordings", "seconds", "repeats"),
    )
    jury.add_argument("--captured", type=Path, required=True, metavar="FOLDER", help=CAPTURED_HELP)
    jury.add_argument(
        "--motion", type=Path, metavar="FOLDER", help="judge the first --clips takes or clips of this folder or corpus"
    )
    jury.add_argument(
        "--judges",
        type=Path,
        metavar="FOLDER",
        help="people whom nothing was trained on, a folder each: how well a classifier of movement tells ours apart",
    )
    rests = measure(
        "rests",
        "how long both arms rest while music plays (the bundled pieces and --recordings) or somebody talks, at the"
        " worst of --clips sounds of each with --repeats seeds",
        *("clips", "recordings", "seconds", "repeats"),
    )
    rests.add_argument("--captured", type=Path, metavar="FOLDER", help=CAPTURED_HELP)
    dial = measure(
        "dial",
        "what the dials of a speaker's manner do: hand speed from --liveliness 0 to 1, and the right hand's share from"
        " --handedness 0 to 1, over --clips voices from --recordings",
        *("clips", "recordings", "seconds", "repeats"),
    )
    dial.add_argument("--captured", type=Path, help="folder of captured motion: also count the jury's rows outside")
    dial.add_argument("--pictures", type=Path, metavar="PNG", help="write a plot")
    actions = measure(
        "actions",
        "the actions: distance from the reference clip with and without each, and the head's rotation in head actions;"
        " means over three seeds",
    )
    actions.add_argument("--pictures", type=Path, metavar="PNG", help="write a picture of the body in each action")
    measure(
        "face", "lip-sync: against phones, and against the loudness of recordings", "clips", "recordings", "seconds"
    )
    feelings = measure("feelings", "whether the face shows what acted voices feel: what is read in its mean curves")
    feelings.add_argument(
        "--recordings",
        type=Path,
        required=True,
        default=argparse.SUPPRESS,
        help="folder of acted speech: names of files, or titles in its manifest.csv, say neutral, happy, angry or sad",
    )
    codes = measure(
        "codes",
        "what is lost of the truth's timing, its turn and the sharing of work between its hands: in its codes, decoded"
        " and shown, in codes that the generator draws after the true past, and in a free run",
        *("corpus", "clips"),
    )
    codes.add_argument("--tokenizer", type=Path, metavar="FOLDER", help="another tokenizer than the bundle's")
    domains = measure(
        "domains",
        "domain confusion: the share of frames danced to speech and gestured to music, by class of voice and music of"
        " --recordings (up to --clips of each, --seconds long); with --captured, how well that tells captured people"
        " apart",
        *("clips", "recordings", "seconds", "repeats"),
    )
    domains.add_argument("--captured", type=Path, help="folder of captured motion to compare with")
    people = measure("people", "the named captured people: means and intervals over people, nothing of the bundle")
    people.add_argument("--captured", type=Path, required=True, metavar="FOLDER", help=CAPTURED_HELP)
    people.add_argument("--seconds", type=float, default=30.0, help="length of a window (default: 30)")
    people.add_argument("--card", type=Path, metavar="JSON", help="also write the numbers into this card.json")
    drift = measure(
        "drift",
        "drift over minutes: a minute of each sound is repeated, and the rows of alive and of the jury in the first and"
        " the last minute are compared, with intervals over sounds (windows of --seconds)",
        *("clips", "recordings", "seconds", "repeats"),
    )
    drift.add_argument("--minutes", type=int, default=10, help="how long the sound is repeated (default: 10)")
    drift.add_argument("--minute", type=float, default=60.0, metavar="S", help="length of a minute (default: 60 s)")


def _shared(parser: argparse.ArgumentParser, *names: str, is_measure: bool = False) -> None:
    """Options of several measures; behind a measure's name they replace what stands before it."""
    options: dict[str, dict[str, Any]] = {
        "corpus": {"type": Path, "help": "use the test clips of this corpus instead of generating some"},
        "clips": {"type": int, "default": 10, "help": "number of held-out clips (default: 10)"},
        "recordings": {
            "type": Path,
            "help": "folder of recorded audio: the dev files of its manifest.csv, or test where none is dev; without"
            " a manifest all files, and paths with 'music' in them are music",
        },
        "split": {
            "choices": ("dev", "test"),
            "default": "dev",
            "help": "recordings to hear; test once for a generator, whose card then says so (default: dev)",
        },
        "again": {"action": "store_true", "help": "hear test again with the same weights; the card says that, too"},
        "seconds": {"type": float, "default": 30.0, "help": "length to use of each recording (default: 30)"},
        "repeats": {
            "type": count,
            "metavar": "N",
            "help": "perform every clip or sound N times, with different seeds (default: 3 for held-out clips; 1 for"
            " `alive`, which with more also shows how far means scatter, and for `domains`)",
        },
        "seed": {"type": int, "default": 0, "help": "seed of sampling (default: 0)"},
        "runtime": {"default": "default", "metavar": "HOW", "help": RUNTIME_HELP},
    }
    for name in (*names, *(("split", "again") if "recordings" in names else ()), "seed", "runtime"):
        parser.add_argument(f"--{name}", **options[name] | ({"default": argparse.SUPPRESS} if is_measure else {}))


def run(args: argparse.Namespace) -> int:
    """Score and print a table, then one line of JSON."""
    from echoavatar.engine.pipeline import load_bundle

    from .evaluate_measures import measure

    bundle = load_bundle(args.model).running(args.runtime)
    print(f"runtime: {bundle.runtime.label}")
    if numbers := measure(args, bundle):
        print(json.dumps(numbers))
    return 0
