"""What words add to a talk: stills at the words whose gestures differ most from those of the sound alone.

    flite -voice slt -t "Hello everyone." talk.wav
    python scripts/film_words.py talk.wav talk.vtt -o docs/results/img/words.webp

WORDS is a file as `echoavatar animate --words` takes it: JSON, or captions. Above, the bundle hears the sound alone;
below, with the same seed, it knows the words too. `echoavatar animate SOUND --words WORDS -o words.mp4` is the film.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.words import Word, read_words
from echoavatar.files.avatar.video import Shot, film
from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import Motion, forward_kinematics
from echoavatar.motion.motion_chunk import join
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import FRAME_RATE_HZ

SIZE, APART_S, LATER_S = (150, 210), 2.0, 0.15  # a gesture's stroke ends about with its word
HANDS = ("leftHand", "rightHand")


def performed(pipeline: Pipeline, sound: Path, words: Sequence[Word], seed: int, liveliness: float) -> Motion:
    """The motion of a session that hears the sound and knows these words."""
    with Engine(pipeline, rewind=0).open(seed=seed, options=MotionOptions(liveliness=liveliness)) as session:
        session.words(words)
        session.push(read_audio(sound))
        session.finish()
        done = join(list(session))
    return Motion(pipeline.skeleton, done.rotations, done.root, FRAME_RATE_HZ)


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sound", type=Path, metavar="SOUND")
    parser.add_argument("words", type=Path, metavar="WORDS")
    parser.add_argument("-o", "--output", type=Path, required=True, help="picture")
    parser.add_argument("--count", type=int, default=10, help="words to show at most (default: 10)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--liveliness", type=float, default=0.8, help="of the speaker, 0 to 1 (default: 0.8)")
    args = parser.parse_args()
    pipeline, words = Pipeline(load_bundle()), read_words(args.words)
    both = [performed(pipeline, args.sound, known, args.seed, args.liveliness) for known in ([], words)]
    joints = pipeline.skeleton.indices(HANDS)
    hands = [forward_kinematics(one.skeleton, one.matrices(), one.root).positions[:, joints] for one in both]
    apart = np.linalg.norm(hands[1] - hands[0], axis=-1).max(1)
    frame_of = {word: min(round((word.start + LATER_S) * FRAME_RATE_HZ), len(apart) - 1) for word in words}
    shown: list[Word] = []
    for word in sorted(words, key=lambda word: -apart[frame_of[word]]):
        if len(shown) < args.count and all(abs(word.start - other.start) > APART_S for other in shown):
            shown.append(word)
    shown.sort(key=lambda word: word.start)
    at, rows = [frame_of[word] for word in shown], []
    for motion in both:
        picked = replace(motion, rotations=motion.rotations[at], root=motion.root[at])
        rows.append(np.concatenate(list(film(picked, shot=Shot(SIZE))), axis=1))
    sheet = Image.fromarray(np.concatenate(rows))
    for place, word in enumerate(shown):
        now = words.index(word)
        said = " ".join(near.text for near in words[max(0, now - 1) : now + 2])
        ImageDraw.Draw(sheet).text(((place + 0.5) * SIZE[0], SIZE[1]), said, fill=(20, 20, 20), anchor="mt")
        print(f"{word.start:6.2f} s  {said:24} hands {apart[frame_of[word]]:.2f} m apart")
    sheet.save(args.output, quality=75, method=6)


if __name__ == "__main__":
    main()
