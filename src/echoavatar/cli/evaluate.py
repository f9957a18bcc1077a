"""`echoavatar evaluate`: scores a bundle on held-out audio and motion. The last line is JSON."""

import argparse
import json
import math
import sys
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from echoavatar.errors import EchoAvatarError

from .serve import RUNTIME_HELP

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from echoavatar.engine.pipeline import Bundle
    from echoavatar.evaluation.actions import ActionScore

TURNS = ("yaw", "pitch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = "example: echoavatar evaluate default --recordings folder/of/speech/and/music"
    parser.add_argument("model", nargs="?", default="default", help="bundle name or folder (default: %(default)s)")
    parser.add_argument("--corpus", type=Path, help="use the test clips of this corpus instead of generating some")
    parser.add_argument("--clips", type=int, default=10, help="number of held-out clips (default: %(default)s)")
    parser.add_argument(
        "--recordings",
        type=Path,
        help="folder of recorded audio: the test files of its manifest.csv; without one all, and paths with 'music' in"
        " them are music",
    )
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="length to use of each recording (default: %(default)s)"
    )
    parser.add_argument(
        "--beside",
        type=Path,
        action="append",
        default=[],
        metavar="GENERATOR",
        help="another generator of the same codes: only compare the audio reliance of both; may be repeated",
    )
    parser.add_argument(
        "--face",
        action="store_true",
        help="measure lip-sync instead: against phones, and against the loudness of recordings",
    )
    parser.add_argument(
        "--actions",
        action="store_true",
        help="measure the actions instead: distance from the reference clip with and without each, and the head's"
        " rotation in head actions; means over three seeds",
    )
    parser.add_argument(
        "--alive",
        action="store_true",
        help="measure how much the body moves and varies instead, beside people: --clips sounds each of speech and"
        " music from --recordings, silence and listening",
    )
    parser.add_argument(
        "--codes",
        action="store_true",
        help="measure what is lost of the truth's timing and turn instead: in its codes, decoded and shown, and in"
        " codes that the generator draws after the true past",
    )
    parser.add_argument(
        "--tokenizer", type=Path, metavar="FOLDER", help="with --codes: another tokenizer than the bundle's"
    )
    parser.add_argument(
        "--domains",
        action="store_true",
        help="measure domain confusion instead: the share of frames danced to speech and gestured to music, by class of"
        " voice and music of --recordings (up to --clips of each, --seconds long); with --captured, how well that"
        " tells captured people apart",
    )
    parser.add_argument("--captured", type=Path, help="--alive, --domains: folder of captured motion to compare with")
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="PNG",
        help="with --actions: a picture of the body in each action; with --alive: stills of each take, and a plot",
    )
    parser.add_argument(
        "--card", type=Path, metavar="JSON", help="with --alive: also write the rows into this card.json of a bundle"
    )
    parser.add_argument(
        "--repeats",
        type=_times,
        metavar="N",
        help="perform every clip or sound N times, with different seeds (default: 3 for held-out clips; 1 for --alive,"
        " which with more also shows how far means scatter)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of sampling (default: %(default)s)")
    parser.add_argument("--runtime", default="default", metavar="HOW", help=RUNTIME_HELP)


def _times(text: str) -> int:
    if (count := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"a clip is performed at least once, got {count}")
    return count


def run(args: argparse.Namespace) -> int:
    """Score and print a table, then one line of JSON."""
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar.evaluation.report import evaluate

    bundle = load_bundle(args.model).running(args.runtime)
    print(f"runtime: {bundle.runtime.label}")
    if args.face:
        return _face(args, bundle)
    if args.actions:
        return _actions(args, bundle)
    if args.alive:
        return _alive(args, bundle)
    if args.domains:
        return _domains(args, bundle)
    clips = _clips(args)
    if args.codes:
        return _codes(args, bundle, clips)
    if args.beside:
        from echoavatar.evaluation.reliance import reliance_table, token_clips
        from echoavatar.models.generator import Generator

        generators = {"model": bundle.generator} | {path.name: Generator.load(path) for path in args.beside}
        print(reliance_table(generators, token_clips(bundle, clips)))
        return 0
    recordings = _recordings(args.recordings, args.seconds) if args.recordings else []
    with _progress() as say:
        scores = evaluate(bundle, clips, recordings, seed=args.seed, repeats=args.repeats or 3, progress=say)
    _print_scores(scores)
    return 0


def _print_scores(scores: "Mapping[str, float]") -> None:
    for key, value in scores.items():
        print(f"{key:<44}{value:>12.4f}")
    print(json.dumps(_rounded(scores)))


def _rounded(scores: "Mapping[str, float]") -> dict[str, float | None]:
    """For JSON; None where there was nothing to measure."""
    return {key: round(value, 5) if math.isfinite(value) else None for key, value in scores.items()}


def _codes(args: argparse.Namespace, bundle: "Bundle", clips: list) -> int:  # type: ignore[type-arg]
    from echoavatar.evaluation.true_codes import true_codes
    from echoavatar.models.tokenizer import BodyTokenizer

    tokenizer = BodyTokenizer.load(args.tokenizer) if args.tokenizer else None
    with tqdm(unit="clip", disable=not sys.stderr.isatty()) as bar:
        found = true_codes(
            bundle, clips, tokenizer=tokenizer, seed=args.seed, progress=lambda done, _: bar.update(done - bar.n)
        )
    for name, scores in found.items():
        print(f"{name:<12}" + "  ".join(f"{key} {value:+.3f}" for key, value in scores.items()))
    print(json.dumps({name: _rounded(scores) for name, scores in found.items()}))
    return 0


def _face(args: argparse.Namespace, bundle: "Bundle") -> int:
    from echoavatar.evaluation.behaviour import SPEECH
    from echoavatar.evaluation.faces import evaluate_face, held_out_tracks

    found = _recordings(args.recordings, args.seconds) if args.recordings else []
    speech = [recording.audio for recording in found if recording.kind == SPEECH]
    with tqdm(unit="clip", disable=not sys.stderr.isatty()) as bar:
        scores = evaluate_face(
            bundle,
            held_out_tracks(args.clips),
            speech,
            seed=args.seed,
            progress=lambda done, _: bar.update(done - bar.n),
        )
    _print_scores(scores._asdict())
    return 0


def _actions(args: argparse.Namespace, bundle: "Bundle") -> int:
    from importlib.resources import as_file, files

    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.evaluation.actions import SEEDS, evaluate_actions
    from echoavatar.models.audio import read_audio

    with as_file(files("echoavatar") / "assets" / "speech.ogg") as source:
        speech = read_audio(source)
    seeds = [args.seed + seed for seed in SEEDS]
    acted = evaluate_actions(Pipeline(bundle), speech, seeds=seeds)
    print(f"{'action':<20}{'off, cm':>10}{'on, cm':>10}{'deg/s':>8}  points its clip moves")
    for one in acted:
        points = ", ".join(one.points[-4:]) + (" .." if len(one.points) > 4 else "")
        print(f"{one.name:<20}{one.off_cm:>10.1f}{one.on_cm:>10.1f}{one.fastest_deg_s:>8.0f}  {points}")
    heads = _head_turns(acted)
    if args.pictures:
        _picture(args.pictures, acted)
    numbers = {one.name: [round(one.off_cm, 2), round(one.on_cm, 2)] for one in acted}
    closer = sum(on < off for off, on in numbers.values())
    print(json.dumps({"off_on_cm": numbers, "closer": closer, "head_off_on_clip_deg": heads}))
    return 0


@contextmanager
def _progress() -> "Iterator[Callable[[str, int, int], None]]":
    """A progress bar: call it with the name of the work, the steps done and the steps in all."""
    with tqdm(disable=not sys.stderr.isatty()) as bar:

        def say(what: str, done: int, total: int) -> None:
            bar.set_description(what, refresh=False)
            bar.total = total
            bar.n = done
            bar.refresh()

        yield say


def _alive(args: argparse.Namespace, bundle: "Bundle") -> int:
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.evaluation import alive
    from echoavatar.evaluation.report import SEED_STRIDE

    if not args.recordings:
        raise EchoAvatarError("--alive performs recorded sound; give a folder with --recordings")
    captured = alive.read_captured(args.captured) if args.captured else []
    sounds = alive.read_sounds(args.recordings, args.seconds, args.clips)
    seeds = [args.seed + SEED_STRIDE * again for again in range(args.repeats or 1)]
    pipeline = Pipeline(bundle)
    with _progress() as say:
        performances = [
            alive.perform(pipeline, sounds, args.seconds, seed=seed, progress=partial(say, f"performing, seed {seed}"))
            for seed in seeds
        ]
        found = alive.report(performances, captured, args.seconds, progress=partial(say, "measuring"))
    if args.pictures:
        from echoavatar.evaluation.alive_picture import draw, sheet
        from echoavatar.files.avatar.sheet import save_picture

        save_picture(args.pictures, sheet(performances[0]))
        draw(found, args.pictures.with_stem(f"{args.pictures.stem}_plot"))
    numbers = alive.as_json(found)
    if args.card:
        asked = f"--alive --clips {args.clips} --seconds {args.seconds:g} --seed {args.seed}"
        asked += f" --repeats {args.repeats}" if args.repeats else ""
        _write_scores(args.card, f"echoavatar evaluate {asked}", numbers)
    print(alive.as_text(found))
    print(json.dumps(numbers))
    return 0


def _domains(args: argparse.Namespace, bundle: "Bundle") -> int:
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.evaluation import domains

    if not args.recordings and not args.captured:
        raise EchoAvatarError(
            "--domains performs recorded sound (--recordings) or measures people (--captured); give one"
        )
    rows = []
    if args.captured:
        with tqdm(unit="take", disable=not sys.stderr.isatty()) as bar:

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done - bar.n)

            people = domains.read_people(args.captured, progress=progress)
        ankles, hands = domains.limits(people)
        print(f"limits that tell all of them apart best: ankles {ankles:.2f} m/s, hands {hands:.2f} arm lengths/s")
        rows += domains.held_out(people)
    if args.recordings:
        sounds = domains.read_sounds(args.recordings, args.seconds, args.clips)
        rows += domains.shares(domains.perform(Pipeline(bundle), sounds, seed=args.seed))
    print(f"limits of the shares: ankles {domains.ANKLES:g} m/s, hands {domains.HANDS:g} arm lengths/s")
    print(domains.as_text(rows))
    numbers = {f"{row.kind}, {row.group}": [round(row.danced, 4), round(row.gestured, 4)] for row in rows}
    print(json.dumps({"danced_gestured": numbers}))
    return 0


def _write_scores(path: Path, command: str, numbers: dict[str, dict[str, float | None]]) -> None:
    """Put the rows of the avatar, without those of people, into a card that is there already."""
    try:
        card = json.loads(path.read_text("utf-8"))
        scores = {label: row for label, row in numbers.items() if "people" not in label and "captured" not in label}
        path.write_text(json.dumps(card | {"alive": {"command": command} | scores}, indent=2) + "\n", "utf-8")
    except (OSError, ValueError, TypeError) as error:
        raise EchoAvatarError(f"--card {path} is not the card of a bundle ({error}); give its card.json") from error


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


def _picture(path: Path, acted: "Sequence[ActionScore]") -> None:
    from echoavatar.files.avatar.sheet import contact_sheet, save_picture
    from echoavatar.motion.kinematics import Motion

    rotations, root = (
        np.stack([getattr(one.motion, part)[one.peak] for one in acted]) for part in ("rotations", "root")
    )
    root[:, [0, 2]] = 0
    motion = Motion(acted[0].motion.skeleton, rotations, root, 30.0)
    columns = min(5, len(acted))
    save_picture(path, contact_sheet(motion, columns=columns, rows=-(-len(acted) // columns), every=1))


def _clips(args: argparse.Namespace) -> list:  # type: ignore[type-arg]
    """Held-out clips: of a corpus, or generated from words, pieces and voices that training never uses."""
    if args.corpus:
        from echoavatar.data import Corpus

        corpus = Corpus(args.corpus)
        names = corpus.names("test", has_mirrored=False)[: args.clips]
        if not names:
            raise EchoAvatarError(f"{args.corpus} has no test clips; make a longer corpus")
        return [corpus.load(name) for name in names]
    from echoavatar.corpora.rehearsal.corpus import TEST_EVERY, Plan, make_clip

    plan = Plan(hours=1.0, seed=987_654, folder=Path("unused"))
    return [make_clip(plan, TEST_EVERY * index + TEST_EVERY - 1) for index in range(args.clips)]


def _recordings(folder: Path, seconds: float) -> list:  # type: ignore[type-arg]
    from echoavatar.evaluation.behaviour import MUSIC, SPEECH
    from echoavatar.evaluation.report import Recording
    from echoavatar.models.audio.recorded_files import decoded, recorded_files

    found = []
    for file in recorded_files(folder, "dev"):
        audio = decoded(file.path)[-int(seconds * 24_000) :]  # the end: training may have used the beginning
        kind = MUSIC if file.kind == "music" else SPEECH
        found.append(Recording(file.path.name, kind, audio.astype(np.float32) / 32_768))
    return found
