"""`echoavatar data`: make, view and measure training data. May import everything below."""

import argparse
import itertools
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from echoavatar.cli.options import seed
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.progress import progress_bar

from . import data_capture, data_face, data_prepare, data_rl_corpus

if TYPE_CHECKING:
    from echoavatar.motion.kinematics import Motion, Skeleton
    from echoavatar_lab.data import Clip

SHORTEST_WINDOW_S, LONGEST_WINDOW_S = 15.0, 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    rehearse = kinds.add_parser(
        "rehearse",
        help="the synthetic rehearsal corpus: speech, music and silence with matching motion",
        description="Make the synthetic rehearsal corpus. The same seed gives the same corpus on all machines with the "
        "same speech engines; an interrupted run continues where it stopped.",
        epilog="example: echoavatar data rehearse --hours 0.2 --seed 1 -o corpus --workers 2",
    )
    rehearse.add_argument("--hours", type=float, default=0.2, help="length of the corpus (default: %(default)s)")
    rehearse.add_argument("--seed", type=seed, default=0, help="random seed of the corpus (default: %(default)s)")
    rehearse.add_argument("-o", "--output", type=Path, default=Path("corpus"), help="folder (default: %(default)s)")
    rehearse.add_argument(
        "--library",
        type=Path,
        help="library of `data capture`, or its folder of BVH: captured people give the bodies and most of the dances",
    )
    rehearse.add_argument(
        "--recordings",
        type=Path,
        help="folder of recorded speech and music for half of the sound; of a manifest.csv only the split train is"
        " heard, without one paths with 'music' are music",
    )
    rehearse.add_argument("--soundfont", type=Path, help="SF2 file with which fluidsynth plays half of the music")
    rehearse.add_argument("--workers", type=int, default=2, help="processes (default: %(default)s)")
    capture = kinds.add_parser(
        "capture",
        help="a library of captured people, from which the rehearsal corpus takes bodies and dances",
        description="Read captured clips once: cut, cleaned, on our rig, as choreography controls in one file.",
    )
    data_capture.add_arguments(capture)
    preview = kinds.add_parser("preview", help="view a corpus: contact sheets and short MP4s with sound")
    preview.add_argument("corpus", type=Path, help="corpus folder")
    preview.add_argument("-o", "--output", type=Path, default=Path("preview"), help="folder (default: %(default)s)")
    preview.add_argument("--clips", type=int, default=2, help="number of clips (default: %(default)s)")
    preview.add_argument("--seconds", type=float, default=16.0, help="length shown of each clip (default: %(default)s)")
    describe = kinds.add_parser("describe", help="statistics of a corpus by kind of sound, next to recorded clips")
    describe.add_argument("corpus", type=Path, help="corpus folder")
    describe.add_argument("--clips", type=int, default=12, help="number of clips (default: %(default)s)")
    describe.add_argument(
        "--beside", type=Path, action="append", default=[], help="a BVH clip to compare with; may be repeated"
    )
    describe.add_argument(
        "--captured",
        type=Path,
        help="folder of BVH whose paths say speech, conversation, dance or idle: how surely a classifier tells the"
        " corpus from these people",
    )
    merge = kinds.add_parser(
        "merge",
        help="several sets as one, such as the paper's mixture of speech and dance",
        description="Make one set of several. Clips keep names and splits; shards are linked, so it takes no space.",
        epilog="example: echoavatar data merge sets/zeroeggs sets/motorica -o sets/all",
    )
    merge.add_argument("sets", type=Path, nargs="+", metavar="SET", help="folders of sets or corpora")
    merge.add_argument("-o", "--output", type=Path, required=True, help="folder of the new set")
    faces = kinds.add_parser("face", help="sound and ARKit curves: takes of Live Link Face, or synthetic clips")
    data_face.add_arguments(faces)
    prepared = "a published dataset (ZeroEGGS, Motorica, BEAT2, Bandai-Namco) or any folder of BVH, from your copy"
    data_prepare.add_arguments(kinds.add_parser("prepare", help=prepared, description=prepared))
    sound = "speech and music without motion, for reinforcement learning"
    data_rl_corpus.add_arguments(kinds.add_parser("rl-corpus", help=sound, description=sound))


def run(args: argparse.Namespace) -> int:
    """Run the sub-command."""
    kinds = {
        "rehearse": _rehearse,
        "capture": data_capture.run,
        "preview": _preview,
        "describe": _describe,
        "face": data_face.run,
        "merge": _merge,
        "prepare": data_prepare.run,
        "rl-corpus": data_rl_corpus.run,
    }
    return kinds[args.kind](args)


def _rehearse(args: argparse.Namespace) -> int:
    from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse
    from echoavatar_lab.data import Corpus

    plan = Plan(
        args.hours, args.seed, args.output, library=args.library, recordings=args.recordings, soundfont=args.soundfont
    )
    with progress_bar() as say:
        made = rehearse(plan, workers=args.workers, progress=partial(say, "clips"))
    print(f"{made} clips, {plan.clips * plan.clip_seconds / 3600:.2f} hours in {plan.folder}")
    print(f"fingerprint {Corpus(plan.folder).fingerprint}")
    return 0


def _merge(args: argparse.Namespace) -> int:
    from echoavatar.timing import FRAME_RATE_HZ
    from echoavatar_lab.data.merge import merge

    with progress_bar() as say:
        corpus = merge(args.sets, args.output, progress=partial(say, "sets"))
    counts = {split: len(corpus.names(split, has_mirrored=False)) for split in ("train", "val", "test")}
    told = ", ".join(f"{count} {split}" for split, count in counts.items() if count)
    print(f"{sum(counts.values())} clips ({told}), {corpus.frames() / FRAME_RATE_HZ / 60:.1f} minutes in {args.output}")
    if licence := corpus.manifest.info["licence"]:
        print(f"licence: {licence}")
    return 0


def _preview(args: argparse.Namespace) -> int:
    from echoavatar.files.avatar.video import Shot, write_film
    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar.motion.kinematics.retarget import retarget
    from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.evaluation.pictures import contact_sheet, save_picture

    make_output_folder(args.output)
    corpus = Corpus(args.corpus)
    for name in tqdm(corpus.names(has_mirrored=False)[: args.clips], unit="clip", disable=None):
        clip = corpus.load(name)
        motion = clip.motion(corpus.skeleton_of(name)).cut(0, round(args.seconds * FRAME_RATE_HZ))
        motion = motion if motion.skeleton.names == HUMANOID.names else retarget(motion)  # the character's rig
        save_picture(args.output / f"{name}.png", contact_sheet(motion))
        sound = clip.audio[: motion.frames * SAMPLES_PER_FRAME]
        write_film(args.output / f"{name}.mp4", motion, sound, shot=Shot((640, 480)))
    print(f"contact sheets and videos in {args.output}")
    return 0


def _describe(args: argparse.Namespace) -> int:
    from echoavatar.motion.formats import read_bvh
    from echoavatar.motion.kinematics.retarget import retarget
    from echoavatar_lab.data import DOMAINS, MUSIC, SILENCE, SPEECH, Corpus

    corpus = Corpus(args.corpus)
    clips = [corpus.load(name) for name in corpus.names(has_mirrored=False)[: args.clips]]
    stretches = {domain: _stretches(clips, domain, corpus.skeleton) for domain in (SPEECH, MUSIC, SILENCE)}
    columns = {DOMAINS[domain]: _mean_over(motions) for domain, motions in stretches.items()}
    for path in args.beside:
        columns[path.stem] = _mean_over([retarget(read_bvh(path))])
    print(f"{'':<26}" + "".join(f"{name[:18]:>20}" for name in columns))
    for row in dict.fromkeys(row for values in columns.values() for row in values):
        print(f"{row:<26}" + "".join(f"{values.get(row, float('nan')):>20.3f}" for values in columns.values()))
    _print_liveliness(stretches)
    if args.captured:
        _print_told_apart(clips, corpus.skeleton, args.captured)
    return 0


def _print_liveliness(motions: "dict[int, list[Motion]]") -> None:
    """A second table: windows of 15 to 30 s of one kind of sound beside captured people (docs/metrics.md)."""
    import numpy as np

    from echoavatar_lab.data import DOMAINS
    from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS, body_points, liveliness, windows
    from echoavatar_lab.evaluation.people import of_card

    found = {
        DOMAINS[domain]: [
            liveliness(window, motion.fps)
            for motion in long
            if motion.seconds >= SHORTEST_WINDOW_S
            for window in windows(body_points(motion), motion.fps, LONGEST_WINDOW_S)
        ]
        for domain, long in motions.items()
    }
    people = of_card()
    print(f"{'how alive':<26}" + "".join(f"{name:>16}{'people':>24}" for name in found))
    for name in STATISTICS:
        cells = ""
        for kind, rows in found.items():
            own, named = float(np.mean([row[name] for row in rows])) if rows else float("nan"), people[kind][name]
            cells += f"{own:>16.3f}{f'{named.mean:.3g} ({named.low:.3g} to {named.high:.3g})':>24}"
        print(f"{name:<26}{cells}")


def _print_told_apart(clips: "list[Clip]", skeleton: "Skeleton", folder: Path) -> None:
    """A third table: accuracy of the classifier of `evaluate BUNDLE alive` on windows of 10 s (docs/metrics.md)."""
    from echoavatar_lab.data import DOMAINS, MUSIC, SILENCE, SPEECH
    from echoavatar_lab.evaluation.alive import COMPARED_S, captured_kind, compare, measure, people_apart
    from echoavatar_lab.evaluation.people import read_people
    from echoavatar_lab.evaluation.takes import Take

    people = [measure(take, LONGEST_WINDOW_S) for take in read_people(folder)]
    print(f"{'told apart':<26}{'corpus':>16}{'people':>24}")
    for domain in (SPEECH, MUSIC, SILENCE):
        kind = DOMAINS[domain]
        theirs = [person for person in people if person.take.kind == captured_kind(kind)]
        ours = [
            measure(Take(clip.name, kind, "", motion), LONGEST_WINDOW_S)
            for clip in clips
            for motion in _stretches([clip], domain, skeleton)
            if motion.seconds >= COMPARED_S
        ]
        print(f"{kind:<26}{compare(ours, theirs)[1]:>16.2f}{people_apart(theirs):>24.2f}")


def _stretches(clips: "list[Clip]", domain: int, skeleton: "Skeleton") -> "list[Motion]":
    """Stretches of at least two seconds with one kind of sound; silence without its first second."""
    import numpy as np

    from echoavatar_lab.data import SILENCE

    found = []
    for clip in clips:
        edges = [0, *(np.flatnonzero(np.diff(clip.domain)) + 1).tolist(), clip.frames]
        for start, stop in itertools.pairwise(edges):
            first = start + 30 if domain == SILENCE else start
            if clip.domain[start] == domain and stop - first >= 60:
                found.append(clip.motion(skeleton).cut(first, stop))
    return found


def _mean_over(motions: "list[Motion]") -> dict[str, float]:
    """Each statistic of `describe`: the mean weighted by length, or the largest; empty without a motion."""
    import numpy as np

    from echoavatar_lab.data.statistics import FASTEST, describe

    found, weights = [describe(motion) for motion in motions], [motion.frames for motion in motions]
    columns = {key: [numbers[key] for numbers in found] for key in (found[0] if found else ())}
    means = {key: float(np.average(column, weights=weights)) for key, column in columns.items()}
    return means | ({FASTEST: max(columns[FASTEST])} if found else {})
