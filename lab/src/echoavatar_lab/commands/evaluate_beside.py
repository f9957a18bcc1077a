"""Measures of `echoavatar evaluate` that compare with people, or a bundle with itself: `people`, `drift`, `dial`."""

import argparse
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.whole_file import write_whole

from .progress import progress_bar

if TYPE_CHECKING:
    from echoavatar.engine.pipeline import Bundle


def people(args: argparse.Namespace, bundle: "Bundle") -> Mapping[str, object]:
    """Measure the named people, print their table, and write it into a card."""
    from echoavatar_lab.evaluation import people as module

    del bundle
    with progress_bar() as say:
        rows = module.measured(module.read_people(args.captured), args.seconds, progress=partial(say, "people"))
    print(module.as_text(module.statistics(rows)))
    numbers = module.as_json(rows)
    if args.card:
        write_card(args.card, "people", f"echoavatar evaluate BUNDLE people --seconds {args.seconds:g}", numbers)
    return numbers


def drift(args: argparse.Namespace, bundle: "Bundle") -> Mapping[str, object]:
    """Perform repeated minutes of sound and compare the first with the last."""
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar_lab.evaluation import drift as module
    from echoavatar_lab.evaluation.report import SEED_STRIDE
    from echoavatar_lab.evaluation.takes import perform, read_sounds

    if not args.recordings:
        raise EchoAvatarError("`drift` performs recorded sound; give a folder with --recordings")
    found = read_sounds(args.recordings, args.minute, args.clips, split=args.split)
    sounds, takes = module.repeated(found, args.minutes, args.minute), []
    pipeline = Pipeline(bundle.without(["face"]))
    with progress_bar() as say:
        for seed in (args.seed + SEED_STRIDE * again for again in range(args.repeats or 1)):
            takes += perform(pipeline, sounds, seed=seed, progress=partial(say, f"performing, seed {seed}"))
        between = (1, args.minutes)
        rows = module.drifts(takes, between, args.seconds, minute_s=args.minute, progress=partial(say, "measuring"))
    print(module.as_text(rows, between))
    return module.as_json(rows)


def dial(args: argparse.Namespace, bundle: "Bundle") -> Mapping[str, object]:
    """Perform speech at each setting of the dials of a manner."""
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar_lab.evaluation import dial as module
    from echoavatar_lab.evaluation.people import read_people
    from echoavatar_lab.evaluation.takes import read_sounds

    if not args.recordings:
        raise EchoAvatarError("`dial` performs recorded speech; give a folder with --recordings")
    captured = read_people(args.captured) if args.captured else []
    sounds = read_sounds(args.recordings, args.seconds, args.clips, split=args.split)
    pipeline = Pipeline(bundle.without(["face"]))
    with progress_bar() as say:
        settings = module.turn_dials(
            pipeline, sounds, captured, args.seconds, seed=args.seed, progress=partial(say, "settings")
        )
    if args.pictures:
        module.draw(settings, args.pictures)
    print(module.as_text(settings))
    return module.as_json(settings)


def write_card(path: Path, key: str, command: str, numbers: Mapping[str, object]) -> None:
    """Put numbers and the command that made them into a card that is there already.

    Raises:
        EchoAvatarError: the file is not a card.
    """
    try:
        card = read_object_file(path)
    except (OSError, EchoAvatarError) as error:
        raise EchoAvatarError(f"--card {path} is not the card of a bundle ({error}); give its card.json") from error
    write_whole(path, json.dumps(card | {key: {"command": command} | dict(numbers)}, indent=2) + "\n")
