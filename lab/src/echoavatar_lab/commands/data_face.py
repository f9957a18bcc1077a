"""`echoavatar data face`: training pairs of sound and face curves, captured or synthetic."""

import argparse
from functools import partial
from pathlib import Path

from tqdm import tqdm

from echoavatar.cli.batch import Batch
from echoavatar.cli.options import seed
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import progress_bar

VIDEOS = (".mov", ".mp4")  # with the sound in them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = (
        "A take is what Live Link Face (iPhone) exports: NAME.csv, and beside it NAME.wav or NAME.mov with its sound.\n"
        "examples:\n"
        "  echoavatar data face takes -o faces             every take of a folder\n"
        "  echoavatar data face take.csv -o faces          one take\n"
        "  echoavatar data face --rehearse 1.1 -o faces    1.1 hours of synthetic speech and lips\n"
        "then: echoavatar train face faces -o runs/face"
    )
    parser.add_argument("takes", nargs="*", type=Path, help="CSV files, or folders of them")
    parser.add_argument("--rehearse", type=float, metavar="HOURS", help="make synthetic clips instead")
    parser.add_argument("--seed", type=seed, default=1, help="seed of synthetic clips (default: %(default)s)")
    parser.add_argument(
        "--offset", type=float, default=0.0, help="time in the sound at which the take begins, seconds (default: 0)"
    )
    parser.add_argument("--timecode", type=int, choices=(30, 60), help="frame rate of the timecode (default: guessed)")
    parser.add_argument("--test-every", type=int, default=10, help="hold out every n-th take (default: %(default)s)")
    parser.add_argument("-o", "--output", type=Path, default=Path("faces"), help="folder (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Make or read clips."""
    if bool(args.takes) == (args.rehearse is not None):
        raise EchoAvatarError("give takes (CSV files or folders), or --rehearse HOURS")
    if args.rehearse is not None:
        return _rehearse(args)
    return _read(args)


def _rehearse(args: argparse.Namespace) -> int:
    from echoavatar_lab.corpora.rehearsal.faces import rehearse_faces

    with progress_bar() as say:
        count = rehearse_faces(args.output, hours=args.rehearse, seed=args.seed, progress=partial(say, "clips"))
    print(f"{count} clips in {args.output}")
    return 0


def _read(args: argparse.Namespace) -> int:
    """Read all takes; name those that fail, which makes the exit code 1."""
    from echoavatar.models.audio import read_audio
    from echoavatar_lab.models.face.clip import pair_with_audio, read_live_link

    paths = sorted({csv for path in args.takes for csv in (path.rglob("*.csv") if path.is_dir() else [path])})
    if not paths:
        raise EchoAvatarError(f"no .csv in {', '.join(map(str, args.takes))}; export takes from Live Link Face")
    batch, seconds = Batch(len(paths)), 0.0
    for number, path in enumerate(tqdm(paths, unit="take", disable=None)):
        split = "test" if number % args.test_every == args.test_every - 1 else "train"
        with batch.each(path.name):
            curves = read_live_link(path, timecode_hz=args.timecode)
            sound = read_audio(_sound_of(path))
            clip = pair_with_audio(path.stem, curves, sound, offset_s=args.offset, split=split)
            clip.save(args.output / f"{path.stem}.npz")
            seconds += len(clip.curves) / 30
    print(f"{batch.made} takes, {seconds / 60:.1f} minutes in {args.output}")
    return batch.end()


def _sound_of(path: Path) -> Path:
    from echoavatar.models.audio.files import SOUND_SUFFIXES, sound_named

    if sound := sound_named(path.with_suffix(""), (*SOUND_SUFFIXES, *VIDEOS)):
        return sound
    raise EchoAvatarError(f"no sound beside it; put {path.stem}.wav (or .mov) into {path.parent}")
