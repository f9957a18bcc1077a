"""`echoavatar baseline`: motion without a model, for audio files or clips, written as clips that `score` reads."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from echoavatar.cli.batch import Batch
from echoavatar.cli.options import seed
from echoavatar.errors import EchoAvatarError

if TYPE_CHECKING:
    from echoavatar_lab.data import Clip

EXAMPLES = """examples:
  echoavatar baseline nearest --train corpus talk.wav song.mp3 -o made    motion whose audio was most similar
  echoavatar baseline random --train sets/all sets/zeroeggs -o made       for the test clips of a set
  echoavatar baseline mean --train corpus clips/*.npz -o made             for the audio of clips
then: echoavatar score made sets/zeroeggs

mean: the mean pose, standing still. random: stretches of training motion, whatever the audio. nearest: every 2.1 s the
training motion with the most similar audio. All use only the training clips of the set. A set is a corpus of `data
rehearse`, `data prepare` or `data merge`.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("kind", choices=("mean", "random", "nearest"), help="which baseline")
    parser.add_argument("audio", nargs="+", type=Path, metavar="AUDIO", help="audio files, clips, or a corpus")
    parser.add_argument("--train", type=Path, required=True, metavar="CORPUS", help="corpus that motion is taken from")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write clips to")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the random choice (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Write one clip for each audio."""
    from dataclasses import replace

    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar_lab.data import Corpus
    from echoavatar_lab.tables.baselines import Baselines

    sounds = [found for given in args.audio for found in _sounds(given)]
    names = [name for name, _ in sounds]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise EchoAvatarError(f"two audio files are named {twice}; rename one of them")
    corpus = Corpus(args.train)
    if corpus.skeleton.names != HUMANOID.names:
        raise EchoAvatarError(f"{args.train} is on a rig of its own; prepare it with --rig unified")
    show, train = not sys.stderr.isatty(), corpus.names("train", has_mirrored=False)
    if not train:
        raise EchoAvatarError(f"{args.train} has no training clips; prepare it again with --test-every 10")
    training = [corpus.load(name) for name in tqdm(train, "reading", unit="clip", disable=show)]
    baselines = Baselines(training)
    batch = Batch(len(sounds))
    for number, (name, heard) in enumerate(tqdm(sounds, "making", unit="clip", disable=show)):
        with batch.each(name):
            clip = heard()
            motion = baselines.make(args.kind, clip.audio, seed=args.seed + number)
            replace(clip, rotations=motion.rotations, root=motion.root).save(args.output / f"{name}.npz")
    print(f"{batch.made} clips in {args.output}")
    return batch.end()


def _sounds(given: Path) -> "list[tuple[str, Callable[[], Clip]]]":
    """The file itself, or the test clips with sound of a set: names, and how the clips are read."""
    if not given.is_dir():
        return [(given.stem, partial(_heard, given))]
    from echoavatar_lab.data import Corpus

    corpus = Corpus(given)
    held_out = [entry.name for entry in corpus.entries("test", has_mirrored=False) if entry.has_sound]
    if not held_out:
        raise EchoAvatarError(
            f"{given} has no test clips with sound; give audio files, or prepare it again with --test-every 10"
        )
    return [(name, partial(corpus.load, name)) for name in held_out]


def _heard(path: Path) -> "Clip":
    """A clip with this audio and no motion yet; labelled as known, otherwise by the file's name."""
    from echoavatar.models.audio import read_audio
    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar.timing import SAMPLES_PER_FRAME
    from echoavatar_lab.data import MUSIC, SPEECH, Clip

    if path.suffix.lower() == ".npz":
        return Clip.load(path)
    audio = read_audio(path)
    frames = len(audio) // SAMPLES_PER_FRAME
    if not frames:
        raise EchoAvatarError(f"{path} is shorter than a frame; use a longer file")
    still = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    kind = MUSIC if "music" in f"{path.parent.name}/{path.stem}".lower() else SPEECH
    return Clip(
        name=path.stem,
        audio=audio[: frames * SAMPLES_PER_FRAME],
        rotations=still,
        root=np.zeros((frames, 3), np.float32),
        domain=np.full(frames, kind, np.uint8),
        split="test",
    )
