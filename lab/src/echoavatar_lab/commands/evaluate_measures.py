"""The measures of `echoavatar evaluate`: each prints its table and returns what the last line says as JSON."""

import json
import math
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.engine.pipeline.bundle import shipped
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.models.audio import read_audio
from echoavatar.whole_file import write_whole
from echoavatar_lab.corpora.rehearsal.corpus import TEST_EVERY, Plan, make_clip
from echoavatar_lab.data import Clip, Corpus
from echoavatar_lab.evaluation import (
    actions,
    alive,
    codes,
    dial,
    domains,
    drift,
    faces,
    feelings,
    jury,
    people,
    report,
    rests,
)
from echoavatar_lab.evaluation import strokes as stroke_times
from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, SPEECH
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.evaluation.onlooker import read_judges, told_apart
from echoavatar_lab.evaluation.paid_for import LEGEND, marked
from echoavatar_lab.evaluation.pictures import save_picture
from echoavatar_lab.evaluation.table import as_json, as_text
from echoavatar_lab.evaluation.takes import Sound, Take, perform, read_sounds
from echoavatar_lab.evaluation.test_split import claim_test
from echoavatar_lab.models.audio.recordings import MANIFEST, decoded, recorded_files
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokenizer.variants import AnyBodyTokenizer
from echoavatar_lab.progress import progress_bar
from echoavatar_lab.tables.run import commit

TURNS = ("yaw", "pitch")
Numbers = Mapping[str, object]
Say = Callable[[str, float, float], None]


def measure(args: Namespace, bundle: Bundle) -> Numbers:
    """Run the measure that is asked for; nothing is returned where the printed table is all."""
    if args.split == "test":
        _claim_test(args)
    return MEASURES[args.measure](args, bundle)


def _whole(args: Namespace, bundle: Bundle) -> Numbers:
    clips = _clips(args)
    if args.beside:
        generators = {"model": bundle.generator} | {path.name: Generator.load(path) for path in args.beside}
        print(codes.reliance_table(generators, codes.token_clips(bundle, clips)))
        return {}
    how = {"extractor": load_shipped(), "seed": args.seed, "repeats": args.repeats or 3}
    with progress_bar() as say:
        rows = report.evaluate(bundle, clips, _recordings(args), **how, progress=say)
    print(as_text(rows))
    return as_json(rows)


def _codes(args: Namespace, bundle: Bundle) -> Numbers:
    tokenizer = AnyBodyTokenizer.load(args.tokenizer) if args.tokenizer else None
    with progress_bar() as say:
        how = {"tokenizer": tokenizer, "seed": args.seed, "progress": partial(say, "true codes")}
        found = codes.true_codes(bundle, _clips(args), **how)
    print("  ".join(f"{key} {value:.3f}" for key, value in found["tokenizer"].items()))
    stages = {name: scores for name, scores in found.items() if name != "tokenizer"}
    print(" " * 28 + "".join(f"{name:>11}" for name in stages))
    for key in stages["truth"]:
        print(f"{marked(key):<28}" + "".join(f"{scores[key]:>11.3f}" for scores in stages.values()))
    print(LEGEND)
    return {name: _rounded(scores) for name, scores in found.items()}


def _face(args: Namespace, bundle: Bundle) -> Numbers:
    speech = [recording.audio for recording in _recordings(args) if recording.kind == SPEECH]
    tracks = faces.held_out_tracks(args.clips)
    with progress_bar() as say:
        scores = faces.evaluate_face(bundle, tracks, speech, seed=args.seed, progress=partial(say, "face"))._asdict()
    for key, value in scores.items():
        print(f"{key:<44}{value:>12.4g}")
    return {key: float(f"{value:.5g}") if math.isfinite(value) else None for key, value in scores.items()}


def _feelings(args: Namespace, bundle: Bundle) -> Numbers:
    with progress_bar() as say:
        speech = feelings.acted_speech(args.recordings)
        found = feelings.read_feelings(bundle, speech, seed=args.seed, progress=partial(say, "feelings"))
    print(feelings.as_text(found))
    return {split: {"right": round(one.right, 4), "confusion": one.confusion.tolist()} for split, one in found.items()}


def _actions(args: Namespace, bundle: Bundle) -> Numbers:
    with as_file(files("echoavatar") / "assets" / "speech.ogg") as source:
        speech = read_audio(source)
    acted = actions.evaluate_actions(Pipeline(bundle), speech, seeds=[args.seed + seed for seed in actions.SEEDS])
    print(f"{'action':<20}{'off, cm':>10}{'on, cm':>10}{'deg/s':>8}  points its clip moves")
    for one in acted:
        points = ", ".join(one.points[-4:]) + (" .." if len(one.points) > 4 else "")
        print(f"{one.name:<20}{one.off_cm:>10.1f}{one.on_cm:>10.1f}{one.fastest_deg_s:>8.0f}  {points}")
    heads = _head_turns(acted)
    if args.pictures:
        save_picture(args.pictures, actions.sheet(acted))
    numbers = {one.name: [round(one.off_cm, 2), round(one.on_cm, 2)] for one in acted}
    closer = sum(on < off for off, on in numbers.values())
    return {"off_on_cm": numbers, "closer": closer, "head_off_on_clip_deg": heads}


def _head_turns(acted: Sequence[actions.ActionScore]) -> dict[str, dict[str, list[float]]]:
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


def _alive(args: Namespace, bundle: Bundle) -> Numbers:
    sounds, captured = _sounds(args), people.read_people(args.captured) if args.captured else []
    pipeline = Pipeline(bundle.without(["face"]))  # no row is of the face, which takes half the time
    with progress_bar() as say:
        performances = [
            alive.performance(
                pipeline, sounds, args.seconds, seed=seed, progress=partial(say, f"performing, seed {seed}")
            )
            for seed in _seeds(args)
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
        write_card(args.card, "alive", f"echoavatar evaluate BUNDLE {asked}", ours)
    print(alive.as_text(found))
    return numbers


def _jury(args: Namespace, bundle: Bundle) -> Numbers:
    captured = people.read_people(args.captured)
    judges = read_judges(args.judges) if args.judges else []
    with progress_bar() as say:
        if args.motion:
            ours = jury.read_moving(args.motion, args.clips)
        else:
            ours = _performed(args, bundle, _sounds(args, "or judges --motion"), say)
        found = jury.verdicts(ours, captured, args.seconds, progress=partial(say, "measuring"))
    known = people.read_people(args.captured, for_training=True) if judges else []  # the others may judge
    sides = {kind: [[take for take in side if take.kind == kind] for side in (ours, judges, known)] for kind in found}
    told = {kind: told_apart(*all_of) for kind, all_of in sides.items()}
    heard = stroke_times.responses(ours, captured)
    print(jury.as_text(found, told), stroke_times.as_text(heard), sep="\n")
    return jury.as_json(found, told) | {"strokes": stroke_times.as_json(heard)}


def _rests(args: Namespace, bundle: Bundle) -> Numbers:
    """Every performance has a seed of its own."""
    _want_recordings(args)
    how, folder, times = {"split": args.split}, args.recordings, args.repeats or 1
    music = rests.with_bundled(read_sounds(folder, args.seconds, args.clips, **how), args.seconds, args.clips)
    talk = [one for one in read_sounds(folder, rests.TALK_S, args.clips, **how) if one.kind == SPEECH]
    pipeline = Pipeline(bundle.without(["face"]))
    with progress_bar() as say:
        takes = [
            take
            for sounds in (music, talk)
            for take in perform(pipeline, sounds * times, seed=args.seed, progress=partial(say, "performing"))
        ]
    captured = people.read_people(args.captured) if args.captured else []
    made, theirs = ([one for take in side for one in rests.rests_of(take, args.seconds)] for side in (takes, captured))
    print(rests.as_text(made, theirs))
    return rests.as_json(made)


def _domains(args: Namespace, bundle: Bundle) -> Numbers:
    if not args.captured:
        _want_recordings(args, "or measures people (--captured)")
    rows = []
    with progress_bar() as say:
        if args.captured:
            moved = domains.read_people(args.captured, progress=partial(say, "reading people"))
            ankles, hands = domains.limits(moved)
            print(f"limits that tell all of them apart best: ankles {ankles:.2f} m/s, hands {hands:.2f} arm lengths/s")
            rows += domains.held_out(moved)
        if args.recordings:
            sounds = domains.read_sounds(args.recordings, args.seconds, args.clips, split=args.split)
            rows += domains.shares(_performed(args, bundle, sounds, say))
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


def _people(args: Namespace, bundle: Bundle) -> Numbers:
    """Measure the named people and write their numbers into a card."""
    with progress_bar() as say:
        rows = people.measured(people.read_people(args.captured), args.seconds, progress=partial(say, "people"))
    print(people.as_text(people.statistics(rows)))
    numbers = people.as_json(rows)
    if args.card:
        write_card(args.card, "people", f"echoavatar evaluate BUNDLE people --seconds {args.seconds:g}", numbers)
    return numbers


def _drift(args: Namespace, bundle: Bundle) -> Numbers:
    """Perform repeated minutes of sound and compare the first with the last."""
    _want_recordings(args)
    found = read_sounds(args.recordings, args.minute, args.clips, split=args.split)
    sounds, between = drift.repeated(found, args.minutes, args.minute), (1, args.minutes)
    with progress_bar() as say:
        takes = _performed(args, bundle, sounds, say)
        rows = drift.drifts(takes, between, args.seconds, minute_s=args.minute, progress=partial(say, "measuring"))
    print(drift.as_text(rows, between))
    return drift.as_json(rows)


def _dial(args: Namespace, bundle: Bundle) -> Numbers:
    """Perform speech at each setting of the dials of a manner."""
    sounds, captured = _sounds(args), people.read_people(args.captured) if args.captured else []
    pipeline = Pipeline(bundle.without(["face"]))
    with progress_bar() as say:
        how, seeds = (pipeline, sounds, captured, args.seconds), _seeds(args)
        settings = dial.turn_dials(*how, seeds=seeds, progress=partial(say, "settings"))
    if args.pictures:
        dial.draw(settings, args.pictures)
    print(dial.as_text(settings))
    return dial.as_json(settings)


MEASURES: dict[str | None, Callable[[Namespace, Bundle], Numbers]] = {
    None: _whole,
    "alive": _alive,
    "jury": _jury,
    "actions": _actions,
    "face": _face,
    "feelings": _feelings,
    "codes": _codes,
    "domains": _domains,
    "people": _people,
    "drift": _drift,
    "dial": _dial,
    "rests": _rests,
}


def _want_recordings(args: Namespace, otherwise: str = "") -> None:
    if not args.recordings:
        what = " ".join(f"`{args.measure}` performs recorded sound {otherwise}".split())
        raise EchoAvatarError(f"{what}; give a folder with --recordings")


def _sounds(args: Namespace, otherwise: str = "") -> list[Sound]:
    """The recorded sound that a measure performs."""
    _want_recordings(args, otherwise)
    return read_sounds(args.recordings, args.seconds, args.clips, split=args.split)


def _seeds(args: Namespace) -> list[int]:
    """A seed for each performance."""
    return [args.seed + report.SEED_STRIDE * again for again in range(args.repeats or 1)]


def _performed(args: Namespace, bundle: Bundle, sounds: Sequence[Sound], say: Say) -> list[Take]:
    """The takes of all performances, without a face."""
    pipeline, takes = Pipeline(bundle.without(["face"])), list[Take]()
    for seed in _seeds(args):
        takes += perform(pipeline, sounds, seed=seed, progress=partial(say, f"performing, seed {seed}"))
    return takes


def write_card(path: Path, key: str, command: str, numbers: Numbers) -> None:
    """Put numbers and the command that made them into a card that is there already.

    Raises:
        EchoAvatarError: the file is not a card.
    """
    try:
        card = read_object_file(path)
    except (OSError, EchoAvatarError) as error:
        raise EchoAvatarError(f"--card {path} is not the card of a bundle ({error}); give its card.json") from error
    write_whole(path, json.dumps(card | {key: {"command": command} | dict(numbers)}, indent=2) + "\n")


def _claim_test(args: Namespace) -> None:
    """Have the generator's card say that the test recordings are heard now."""
    if not args.recordings or not (args.recordings / MANIFEST).is_file():
        raise EchoAvatarError(f"--split test is of --recordings with a {MANIFEST} that marks files as test; give them")
    folder = Path(str(files("echoavatar") / "bundles" / args.model)) if args.model in shipped() else Path(args.model)
    if not folder.is_dir():
        raise EchoAvatarError(f"--split test writes into the card of {args.model}: give the bundle's folder")
    words = f"echoavatar evaluate BUNDLE {args.measure or ''} --recordings {args.recordings.name} --split test"
    claim_test(folder / "generator", command=" ".join(words.split()), commit=commit(), is_again=args.again)


def _rounded(scores: Mapping[str, float]) -> dict[str, float | None]:
    """For JSON; None where there was nothing to measure."""
    return {key: round(value, 5) if math.isfinite(value) else None for key, value in scores.items()}


def _clips(args: Namespace) -> list[Clip]:
    """Held-out clips: of a corpus, or generated from words, pieces and voices that training never uses."""
    if args.corpus:
        corpus = Corpus(args.corpus)
        names = corpus.names("test", has_mirrored=False)[: args.clips]
        if not names:
            raise EchoAvatarError(f"{args.corpus} has no test clips; make a longer corpus")
        return [corpus.load(name) for name in names]
    plan = Plan(hours=1.0, seed=987_654, folder=Path("unused"))
    return [make_clip(plan, TEST_EVERY * index + TEST_EVERY - 1) for index in range(args.clips)]


def _recordings(args: Namespace) -> list[Sound]:
    """Recordings of known kind, as far as `--seconds` from their ends: training may have used the beginnings."""
    found = []
    for file in recorded_files(args.recordings, args.split) if args.recordings else ():
        audio = decoded(file.path)[-int(args.seconds * 24_000) :]
        kind = MUSIC if file.kind == MUSIC else SPEECH
        found.append(Sound(file.path.name, kind, "", audio.astype(np.float32) / 32_768))
    return found
