"""`echoavatar evaluate`: scores a bundle on held-out audio and motion. The last line is JSON."""

import argparse
import json
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from echoavatar.cli.options import RUNTIME_HELP
from echoavatar.errors import EchoAvatarError

from . import evaluate_beside as beside
from .progress import progress_bar

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from echoavatar.engine.pipeline import Bundle
    from echoavatar_lab.data import Clip
    from echoavatar_lab.evaluation.actions import ActionScore
    from echoavatar_lab.evaluation.table import Row
    from echoavatar_lab.evaluation.takes import Sound

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
TURNS = ("yaw", "pitch")
CAPTURED_HELP = "folder of the named clips of captured people: our list, or its own people.csv (docs/metrics.md)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments, and the measures with their own."""
    parser.epilog = EXAMPLES
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
    dial = measure(
        "dial",
        "what the dials of a speaker's manner do: hand speed from --liveliness 0 to 1, and the right hand's share from"
        " --handedness 0 to 1, over --clips voices from --recordings",
        *("clips", "recordings", "seconds"),
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
            "type": _times,
            "metavar": "N",
            "help": "perform every clip or sound N times, with different seeds (default: 3 for held-out clips; 1 for"
            " `alive`, which with more also shows how far means scatter, and for `domains`)",
        },
        "seed": {"type": int, "default": 0, "help": "seed of sampling (default: 0)"},
        "runtime": {"default": "default", "metavar": "HOW", "help": RUNTIME_HELP},
    }
    for name in (*names, *(("split", "again") if "recordings" in names else ()), "seed", "runtime"):
        parser.add_argument(f"--{name}", **options[name] | ({"default": argparse.SUPPRESS} if is_measure else {}))


def _times(text: str) -> int:
    if (count := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"a clip is performed at least once, got {count}")
    return count


def run(args: argparse.Namespace) -> int:
    """Score and print a table, then one line of JSON."""
    from echoavatar.engine.pipeline import load_bundle

    bundle = load_bundle(args.model).running(args.runtime)
    print(f"runtime: {bundle.runtime.label}")
    if args.split == "test":
        _claim_test(args)
    own = {"alive": _alive, "jury": _jury, "actions": _actions, "face": _face, "feelings": _feelings, "codes": _codes}
    own |= {"domains": _domains, "people": beside.people, "drift": beside.drift, "dial": beside.dial}
    numbers = own.get(args.measure, _whole)(args, bundle)
    if numbers:
        print(json.dumps(numbers))
    return 0


def _whole(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar.models.generator import Generator
    from echoavatar_lab.evaluation.codes import reliance_table, token_clips
    from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
    from echoavatar_lab.evaluation.report import evaluate
    from echoavatar_lab.evaluation.table import as_json, as_text

    clips = _clips(args)
    if args.beside:
        generators = {"model": bundle.generator} | {path.name: Generator.load(path) for path in args.beside}
        print(reliance_table(generators, token_clips(bundle, clips)))
        return {}
    with progress_bar() as say:
        rows: list[Row] = evaluate(
            bundle,
            clips,
            _recordings(args),
            extractor=load_shipped(),
            seed=args.seed,
            repeats=args.repeats or 3,
            progress=say,
        )
    print(as_text(rows))
    return as_json(rows)


def _codes(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar_lab.evaluation.codes import true_codes
    from echoavatar_lab.evaluation.paid_for import LEGEND, marked
    from echoavatar_lab.models.tokenizer.variants import AnyBodyTokenizer

    tokenizer = AnyBodyTokenizer.load(args.tokenizer) if args.tokenizer else None
    with progress_bar() as say:
        found = true_codes(
            bundle, _clips(args), tokenizer=tokenizer, seed=args.seed, progress=partial(say, "true codes")
        )
    print("  ".join(f"{key} {value:.3f}" for key, value in found["tokenizer"].items()))
    stages = {name: scores for name, scores in found.items() if name != "tokenizer"}
    print(" " * 28 + "".join(f"{name:>11}" for name in stages))
    for key in stages["truth"]:
        print(f"{marked(key):<28}" + "".join(f"{scores[key]:>11.3f}" for scores in stages.values()))
    print(LEGEND)
    return {name: _rounded(scores) for name, scores in found.items()}


def _face(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar_lab.evaluation.faces import evaluate_face, held_out_tracks
    from echoavatar_lab.evaluation.metrics.liveliness import SPEECH

    speech = [recording.audio for recording in _recordings(args) if recording.kind == SPEECH]
    tracks = held_out_tracks(args.clips)
    with progress_bar() as say:
        scores = evaluate_face(bundle, tracks, speech, seed=args.seed, progress=partial(say, "face"))._asdict()
    for key, value in scores.items():
        print(f"{key:<44}{value:>12.4g}")
    return {key: float(f"{value:.5g}") if math.isfinite(value) else None for key, value in scores.items()}


def _feelings(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar_lab.evaluation.feelings import acted_speech, as_text, read_feelings

    with progress_bar() as say:
        speech = acted_speech(args.recordings)
        found = read_feelings(bundle, speech, seed=args.seed, progress=partial(say, "feelings"))
    print(as_text(found))
    return {split: {"right": round(one.right, 4), "confusion": one.confusion.tolist()} for split, one in found.items()}


def _actions(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from importlib.resources import as_file, files

    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.models.audio import read_audio
    from echoavatar_lab.evaluation.actions import SEEDS, evaluate_actions, sheet
    from echoavatar_lab.evaluation.pictures import save_picture

    with as_file(files("echoavatar") / "assets" / "speech.ogg") as source:
        speech = read_audio(source)
    acted = evaluate_actions(Pipeline(bundle), speech, seeds=[args.seed + seed for seed in SEEDS])
    print(f"{'action':<20}{'off, cm':>10}{'on, cm':>10}{'deg/s':>8}  points its clip moves")
    for one in acted:
        points = ", ".join(one.points[-4:]) + (" .." if len(one.points) > 4 else "")
        print(f"{one.name:<20}{one.off_cm:>10.1f}{one.on_cm:>10.1f}{one.fastest_deg_s:>8.0f}  {points}")
    heads = _head_turns(acted)
    if args.pictures:
        save_picture(args.pictures, sheet(acted))
    numbers = {one.name: [round(one.off_cm, 2), round(one.on_cm, 2)] for one in acted}
    closer = sum(on < off for off, on in numbers.values())
    return {"off_on_cm": numbers, "closer": closer, "head_off_on_clip_deg": heads}


def _head_turns(acted: "Sequence[ActionScore]") -> dict[str, dict[str, list[float]]]:
    """Print the head actions and return them by name: rotation without the action, with it, and in the clip."""
    found: dict[str, dict[str, list[float]]] = {}
    print(f"{'head turns, degrees':<20}" + "".join(f"{way + ' off':>11}{'on':>7}{'clip':>7}" for way in TURNS))
    for one in acted:
        if one.is_head_action:
            heads = one.head_off, one.head_on, one.head_clip
            found[one.name] = {way: [round(getattr(head, way), 1) for head in heads] for way in TURNS}
            off_on_clip = (f"{off:>11.0f}{on:>7.0f}{own:>7.0f}" for off, on, own in found[one.name].values())
            print(f"{one.name:<20}" + "".join(off_on_clip))
    return found


def _alive(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar_lab.evaluation import alive
    from echoavatar_lab.evaluation.people import read_people
    from echoavatar_lab.evaluation.pictures import save_picture
    from echoavatar_lab.evaluation.report import SEED_STRIDE
    from echoavatar_lab.evaluation.takes import read_sounds

    if not args.recordings:
        raise EchoAvatarError("`alive` performs recorded sound; give a folder with --recordings")
    captured = read_people(args.captured) if args.captured else []
    sounds = read_sounds(args.recordings, args.seconds, args.clips, split=args.split)
    seeds = [args.seed + SEED_STRIDE * again for again in range(args.repeats or 1)]
    pipeline = Pipeline(bundle.without(["face"]))  # no row is of the face, which takes half the time
    with progress_bar() as say:
        performances = [
            alive.performance(
                pipeline, sounds, args.seconds, seed=seed, progress=partial(say, f"performing, seed {seed}")
            )
            for seed in seeds
        ]
        found = alive.report(performances, captured, args.seconds, progress=partial(say, "measuring"))
    if args.pictures:
        save_picture(args.pictures, alive.sheet(performances[0]))
        alive.draw(found, args.pictures.with_stem(f"{args.pictures.stem}_plot"))
    numbers = alive.as_json(found)
    if args.card:
        asked = f"alive --clips {args.clips} --seconds {args.seconds:g} --seed {args.seed}"
        asked += f" --repeats {args.repeats}" if args.repeats else ""
        ours = {label: row for label, row in numbers.items() if "people" not in label}
        beside.write_card(args.card, "alive", f"echoavatar evaluate BUNDLE {asked}", ours)
    print(alive.as_text(found))
    return numbers


def _jury(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar_lab.evaluation import jury, strokes
    from echoavatar_lab.evaluation.onlooker import read_judges, told_apart
    from echoavatar_lab.evaluation.people import read_people
    from echoavatar_lab.evaluation.report import SEED_STRIDE
    from echoavatar_lab.evaluation.takes import perform, read_sounds

    if not args.motion and not args.recordings:
        raise EchoAvatarError("`jury` performs recorded sound (--recordings) or judges --motion; give one")
    captured = read_people(args.captured)
    judges = read_judges(args.judges) if args.judges else []
    ours = jury.read_moving(args.motion, args.clips) if args.motion else []
    with progress_bar() as say:
        if not args.motion:
            sounds = read_sounds(args.recordings, args.seconds, args.clips, split=args.split)
            pipeline = Pipeline(bundle.without(["face"]))
            for seed in (args.seed + SEED_STRIDE * again for again in range(args.repeats or 1)):
                ours += perform(pipeline, sounds, seed=seed, progress=partial(say, f"performing, seed {seed}"))
        found = jury.verdicts(ours, captured, args.seconds, progress=partial(say, "measuring"))
    sides = {kind: [[take for take in side if take.kind == kind] for side in (ours, judges)] for kind in found}
    told = {kind: told_apart(*both) for kind, both in sides.items()}
    heard = strokes.responses(ours, captured)
    print(jury.as_text(found, told), strokes.as_text(heard), sep="\n")
    return jury.as_json(found, told) | {"strokes": strokes.as_json(heard)}


def _domains(args: argparse.Namespace, bundle: "Bundle") -> "Mapping[str, object]":
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar_lab.evaluation import domains
    from echoavatar_lab.evaluation.report import SEED_STRIDE
    from echoavatar_lab.evaluation.takes import perform

    if not args.recordings and not args.captured:
        raise EchoAvatarError(
            "`domains` performs recorded sound (--recordings) or measures people (--captured); give one"
        )
    rows = []
    if args.captured:
        with progress_bar() as say:
            people = domains.read_people(args.captured, progress=partial(say, "reading people"))
        ankles, hands = domains.limits(people)
        print(f"limits that tell all of them apart best: ankles {ankles:.2f} m/s, hands {hands:.2f} arm lengths/s")
        rows += domains.held_out(people)
    if args.recordings:
        sounds = domains.read_sounds(args.recordings, args.seconds, args.clips, split=args.split)
        pipeline = Pipeline(bundle.without(["face"]))
        seeds = [args.seed + SEED_STRIDE * again for again in range(args.repeats or 1)]
        rows += domains.shares([take for seed in seeds for take in perform(pipeline, sounds, seed=seed)])
    print(f"limits of the shares: ankles {domains.ANKLES:g} m/s, hands {domains.HANDS:g} arm lengths/s")
    print(domains.as_text(rows))
    named = {f"{row.kind}, {row.group}": row for row in rows}
    return {
        "danced_gestured": {name: [round(row.danced, 4), round(row.gestured, 4)] for name, row in named.items()},
        "intervals": {
            name: [list(_rounded(one._asdict()).values()) for one in (row.danced_interval, row.gestured_interval)]
            for name, row in named.items()
        },
    }


def _claim_test(args: argparse.Namespace) -> None:
    """Have the generator's card say that the test recordings are heard now."""
    from importlib.resources import files

    from echoavatar.engine.pipeline.bundle import shipped
    from echoavatar_lab.evaluation.test_split import claim_test
    from echoavatar_lab.models.audio.recordings import MANIFEST
    from echoavatar_lab.tables.run import commit

    if not args.recordings or not (args.recordings / MANIFEST).is_file():
        raise EchoAvatarError(f"--split test is of --recordings with a {MANIFEST} that marks files as test; give them")
    folder = Path(str(files("echoavatar") / "bundles" / args.model)) if args.model in shipped() else Path(args.model)
    if not folder.is_dir():
        raise EchoAvatarError(f"--split test writes into the card of {args.model}: give the bundle's folder")
    words = f"echoavatar evaluate BUNDLE {args.measure or ''} --recordings {args.recordings.name} --split test"
    claim_test(folder / "generator", command=" ".join(words.split()), commit=commit(), is_again=args.again)


def _rounded(scores: "Mapping[str, float]") -> dict[str, float | None]:
    """For JSON; None where there was nothing to measure."""
    return {key: round(value, 5) if math.isfinite(value) else None for key, value in scores.items()}


def _clips(args: argparse.Namespace) -> "list[Clip]":
    """Held-out clips: of a corpus, or generated from words, pieces and voices that training never uses."""
    if args.corpus:
        from echoavatar_lab.data import Corpus

        corpus = Corpus(args.corpus)
        names = corpus.names("test", has_mirrored=False)[: args.clips]
        if not names:
            raise EchoAvatarError(f"{args.corpus} has no test clips; make a longer corpus")
        return [corpus.load(name) for name in names]
    from echoavatar_lab.corpora.rehearsal.corpus import TEST_EVERY, Plan, make_clip

    plan = Plan(hours=1.0, seed=987_654, folder=Path("unused"))
    return [make_clip(plan, TEST_EVERY * index + TEST_EVERY - 1) for index in range(args.clips)]


def _recordings(args: argparse.Namespace) -> "list[Sound]":
    import numpy as np

    from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, SPEECH
    from echoavatar_lab.evaluation.takes import Sound
    from echoavatar_lab.models.audio.recordings import decoded, recorded_files

    found = []
    for file in recorded_files(args.recordings, args.split) if args.recordings else ():
        audio = decoded(file.path)[-int(args.seconds * 24_000) :]  # the end: training may have used the beginning
        kind = MUSIC if file.kind == MUSIC else SPEECH
        found.append(Sound(file.path.name, kind, "", audio.astype(np.float32) / 32_768))
    return found
