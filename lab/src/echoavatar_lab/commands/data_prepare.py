"""`echoavatar data prepare`: converts a published dataset, or any folder of BVH, to a set that `train` reads."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.cli.options import MAP_HELP
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import progress_bar

from .config_options import add_fields, given_fields

if TYPE_CHECKING:
    from echoavatar_lab.datasets import Outcome, SetOptions, Survey

EXAMPLES = """SRC, in your own copy of the dataset:
  zeroeggs   the unpacked Zeggs_data (clean/*.bvh + *.wav, info.csv)
  motorica   motorica_dance_dataset (bvh/*.bvh, wav/*.wav, or LDA's *.expmap_30fps.pkl); --sound any includes dances
             without published music
  beat2      beat_english_v2.0.0 (smplxflame_30/*.npz, wave16k/*.wav, train_test_split.csv)
  bandai     dataset-1 and dataset-2 (*.bvh, no sound: for a tokenizer)
  bvh        any folder; sound of the same name beside each file, or in wav/ beside bvh/

examples:
  echoavatar data prepare zeroeggs Zeggs_data -o sets/zeroeggs --dry-run       report only, write nothing
  echoavatar data prepare zeroeggs Zeggs_data -o sets/zeroeggs --workers 4     run again to continue after a stop
  echoavatar data prepare beat2 BEAT2/beat_english_v2.0.0 -o sets/scott --speakers 2
  echoavatar data prepare motorica motorica_dance_dataset -o sets/motorica --sound any --only 'kthstreet_*'
  echoavatar data prepare bvh my_takes -o sets/mine --codec runs/codec --tokenizer runs/tokenizer   with tokens
then:
  echoavatar train tokenizer sets/zeroeggs -o runs/tokenizer
  echoavatar train tokens sets/zeroeggs -o runs/tokens --codec runs/codec --tokenizer runs/tokenizer

docs/datasets.md describes every step, the layout of the output, licences and what may be shipped. A recording that
cannot be used is named with the reason and does not stop the others; the exit code is 1 only if nothing could be
prepared, or with --strict.
"""


CHOSEN = ("sound", "test_every", "length_tolerance")
MADE = ("rig", "fingers", "seed", "body_model", "shard_minutes")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    from echoavatar_lab.datasets.source import SetOptions

    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "layout",
        metavar="DATASET",
        choices=("zeroeggs", "motorica", "beat2", "bandai", "bvh"),
        help="zeroeggs, motorica, beat2, bandai, or bvh for any folder",
    )
    parser.add_argument("source", type=Path, metavar="SRC", help="your copy of the dataset")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="output folder")
    parser.add_argument("--dry-run", action="store_true", help="report what would be done, from headers; write nothing")
    parser.add_argument("--strict", action="store_true", help="exit with 1 if any recording failed")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: %(default)s)")
    chosen = parser.add_argument_group("which recordings")
    chosen.add_argument(
        "--only", action="append", default=[], metavar="GLOB", help="names that match this pattern; may be repeated"
    )
    chosen.add_argument(
        "--speakers", nargs="+", default=[], metavar="SPEAKER", help="numbers or names of speakers (BEAT2: 2)"
    )
    chosen.add_argument("--additional", action="store_true", help="BEAT2: train on the additional recordings too")
    defaults = {"sound": "need, but none for bandai", "test_every": "the published split"}
    add_fields(chosen, SetOptions, CHOSEN, default=defaults)
    made = parser.add_argument_group("how they are made")
    add_fields(made, SetOptions, MADE)
    made.add_argument("--map", type=Path, metavar="FILE", help=f"of the BVH's rig: {MAP_HELP}")
    made.add_argument("--no-mirror", action="store_true", help="do not list mirror images of the training clips")
    after = parser.add_argument_group("afterwards")
    after.add_argument("--codec", type=Path, help="trained codec; with --tokenizer, also write DIR/tokens")
    after.add_argument("--tokenizer", type=Path, help="trained motion tokenizer for this set's rig")
    after.add_argument("--no-pictures", action="store_true", help="do not draw DIR/overview")


def run(args: argparse.Namespace) -> int:
    """Survey, prepare, report."""
    if (args.codec is None) != (args.tokenizer is None):
        raise EchoAvatarError("tokens need both --codec and --tokenizer")
    from echoavatar.motion.formats.joint_map import read_map
    from echoavatar_lab.datasets import SetOptions, survey_of

    survey = survey_of(args.layout, args.source, only=args.only, speakers=args.speakers, has_additional=args.additional)
    given = ({"sound": "none"} if args.layout == "bandai" else {}) | given_fields(args, (*CHOSEN, *MADE))
    options = SetOptions(mirror=not args.no_mirror, joints=read_map(args.map), **given)
    _print_survey(survey)
    if args.dry_run:
        return _print_forecast(survey, options, args)
    outcome = _prepare(args, survey, options)
    _print_outcome(outcome)
    if args.codec:
        _write_tokens(args)
    if not args.no_pictures:
        _draw_pictures(outcome, args)
    _print_failures(outcome.failures)
    print(f"report in {args.output / 'report.json'}")
    return 1 if args.strict and outcome.failures else 0


def _prepare(args: argparse.Namespace, survey: "Survey", options: "SetOptions") -> "Outcome":
    from echoavatar_lab.datasets import prepare

    try:
        with progress_bar() as say:
            how = {"workers": args.workers, "progress": partial(say, "clips")}
            return prepare(args.layout, survey, args.output, options, **how)
    except KeyboardInterrupt:
        print(f"finished parts are in {args.output}; the same call continues from there")
        raise


def _print_survey(survey: "Survey") -> None:
    print(f"{survey.terms.title}: {len(survey.recordings)} recordings; licence: {survey.terms.licence}")
    print(f"may be shipped: {survey.terms.may_ship}")
    for line in survey.missing:
        print(f"missing from this copy: {line}")
    reasons: dict[str, list[str]] = {}
    for one in survey.left_out:
        reasons.setdefault(one.why, []).append(one.name)
    for why, names in reasons.items():
        print(f"left out, {why}: {len(names)} ({_first_three(names)})")


def _print_forecast(survey: "Survey", options: "SetOptions", args: argparse.Namespace) -> int:
    from echoavatar_lab.datasets.prepare_dataset import forecast, split_source

    found = forecast(survey.recordings, options)
    for split, count in sorted(found.clips.items()):
        print(f"{split}: {count} clips, {found.seconds[split] / 60:.1f} minutes")
    print(f"split: {split_source(survey, options)}")
    print(f"{args.output} would hold about {found.bytes / 1e6:.1f} MB; nothing was written")
    _print_failures(found.failures, "would fail")
    return 1 if not found.clips or (args.strict and found.failures) else 0


def _print_outcome(outcome: "Outcome") -> None:
    info = outcome.corpus.manifest.info["statistics"]
    splits = ", ".join(f"{split} {count} ({info['minutes'][split]:.1f} min)" for split, count in info["clips"].items())
    print(
        f"{len(outcome.made)} prepared, {len(outcome.kept)} kept from before, {len(outcome.failures)} failed,"
        f" in {outcome.seconds:.0f} s; the set: {splits}, {info['mirror_images']} mirror images"
    )
    if not info["mirror_images"] and outcome.corpus.manifest.info["options"]["mirror"] and "train" in info["clips"]:
        print("no mirror images: left and right of this rig differ; --rig unified makes them")
    mended = [name for name, one in outcome.receipts.items() if one.mended]
    if mended:
        print(f"new fingers (static or erratic before): {len(mended)} clips ({_first_three(mended)})")
    for name, one in outcome.receipts.items():
        for note in one.notes:
            print(f"  note  {name}: {note}")
    close = [one.fidelity for one in outcome.receipts.values() if one.fidelity]
    if close:
        mean = {key: sum(one[key] for one in close) / len(close) for key in close[0]}
        print(
            f"against the source: arms within {mean['arm_angle_deg']:.1f} degrees, hands' distance within"
            f" {mean['hands_apart_error']:.3f} arm lengths, feet agree on standing in"
            f" {100 * mean['contacts_agree']:.0f} % of frames, skating {mean['skate_source_cm_s']:.1f} ->"
            f" {mean['skate_cm_s']:.1f} cm/s"
        )


def _first_three(names: list[str]) -> str:
    """The first three names."""
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")


def _print_failures(failures: "tuple[tuple[str, str], ...]", word: str = "failed") -> None:
    if not failures:
        return
    width = max(len(name) for name, _ in failures)
    print(f"{word}:")
    for name, why in failures:
        print(f"  {name:<{width}}  {why}")


def _write_tokens(args: argparse.Namespace) -> None:
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.models.audio.codec import AudioCodec
    from echoavatar_lab.models.tokenize import tokenize_corpus
    from echoavatar_lab.models.tokenizer.variants import AnyBodyTokenizer

    codec = AudioCodec.load(args.codec).eval()
    tokenizer = AnyBodyTokenizer.load(args.tokenizer).eval()
    corpus, folder = Corpus(args.output), args.output / "tokens"
    with progress_bar() as say:
        told, can_mirror = partial(say, "tokens"), corpus.can_mirror
        count = tokenize_corpus(corpus, codec, tokenizer, folder, is_mirrored_too=can_mirror, progress=told)
    print(f"{count} token files in {folder}")


def _draw_pictures(outcome: "Outcome", args: argparse.Namespace) -> None:
    from echoavatar_lab.datasets.overview import draw_overview

    written = draw_overview(outcome.corpus, args.output / "overview")
    print(f"{len(written)} pictures in {args.output / 'overview'}")
