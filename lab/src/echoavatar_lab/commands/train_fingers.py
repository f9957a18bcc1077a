"""`echoavatar train fingers`: trains the model of `refine-fingers` on motion with good fingers."""

import argparse
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError, MotionError

from .recipe import Options, Settings

if TYPE_CHECKING:
    from echoavatar.models.fingers.clips import FingerClip

EXAMPLES = """SOURCE: a corpus (`echoavatar data rehearse`) or a folder of BVH; frozen fingers are ignored.
examples:
  echoavatar train fingers corpus -o runs/fingers                            about six minutes on a quiet core
  echoavatar train fingers corpus --recordings takes -o runs/fingers         30 % of the windows from recorded takes
  echoavatar train fingers corpus -o runs/fingers --minutes 5                stop after five; call again to continue
then: echoavatar refine-fingers in.bvh out.bvh --model runs/fingers
"""
_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser, options: Options) -> None:
    """Declare the arguments that only fingers have."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EXAMPLES
    parser.add_argument("--recordings", type=Path, help="folder of recorded BVH clips to train on as well")
    options.add("--steps", "training.steps", 3000, type=int, help="optimiser steps")
    options.add("--batch", "training.batch", 32, type=int, help="windows per step")
    options.add("--rate", "training.learning_rate", 1e-3, type=float, help="peak learning rate")
    options.add("--width", "model.width", 128, type=int, help="channels")
    options.add("--layers", "model.layers", 3, type=int, help="transformer blocks")
    parser.add_argument("--minutes", type=float, help="stop this call after so many minutes; call again to continue")


def train(args: argparse.Namespace, settings: Settings, card: dict[str, object], how: dict[str, Any]) -> None:
    """Train, then score the model on the corpus's test clips."""
    from echoavatar import checkpoint
    from echoavatar.models.fingers.model import FingerConfig
    from echoavatar_lab.evaluation.fingers import measure_fingers
    from echoavatar_lab.models.fingers import FingerTraining, train_fingers

    config = settings.checked(FingerConfig, "model")
    training = settings.checked(FingerTraining, "training")
    clips = list(_clips(args.source, "train", config.frames))
    recorded = list(_recordings(args.recordings, config.frames)) if args.recordings else []
    model = train_fingers(
        config, training, clips, args.output, recorded=recorded, minutes=args.minutes, card=card, **how
    )
    tests = [clip for clip in _clips(args.source, "test", config.frames) if clip.is_moving.all()]
    if tests:
        scores = measure_fingers(model, tests)
        model.save(args.output, checkpoint.read_card(args.output) | {"scores": scores})


def _clips(source: Path, split: str, frames: int) -> "Iterator[FingerClip]":
    """Clips of one split of a corpus; of a folder of BVH files, all are for training."""
    if not (source / "manifest.json").is_file():
        yield from _recordings(source, frames) if split == "train" else ()
        return
    from echoavatar.models.fingers.clips import finger_clip
    from echoavatar.motion.kinematics import Motion
    from echoavatar.timing import FRAME_RATE_HZ
    from echoavatar_lab.data import Corpus

    corpus = Corpus(source)
    for name in tqdm(corpus.names(split, has_mirrored=False), desc="reading", unit="clip", leave=False):
        stored = corpus.motion(name)
        motion = Motion(corpus.skeleton_of(name), stored.rotations, stored.root, float(FRAME_RATE_HZ))
        yield finger_clip(motion, at_least=frames)


def _recordings(folder: Path, frames: int) -> "Iterator[FingerClip]":
    """Every BVH below a folder whose rig is known; the log names the others."""
    from echoavatar.models.fingers.clips import finger_clip
    from echoavatar.motion.formats import read_bvh

    paths = sorted(folder.rglob("*.bvh"))
    if not paths:
        raise EchoAvatarError(f"{folder} holds neither a corpus nor .bvh files; give another folder")
    left_out = []
    for path in tqdm(paths, desc="reading", unit="clip", leave=False):
        motion = read_bvh(path)
        try:
            yield finger_clip(motion, at_least=frames)
        except MotionError:
            left_out.append(path.name)
    if left_out:
        _log.warning("left out, because their rigs are unknown: %s", ", ".join(left_out))
