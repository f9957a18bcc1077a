"""Stills of 20 s performances of a bundle, two a second: held-out voices and tracks, and speech over music.

    python scripts/film_stills.py --recordings RECORDINGS -o stills                  # a picture for each sound
    python scripts/film_stills.py --recordings RECORDINGS -o stills --grid docs/results/img/films.webp

RECORDINGS is a folder as `echoavatar evaluate BUNDLE alive` reads it (docs/metrics.md); only its dev split is heard.
Each `NN_kind_name.webp` has four rows of ten stills, half a second apart; the camera follows the hips. `--grid` also
writes twelve stills of each sound.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from tqdm import tqdm

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, SPEECH
from echoavatar_lab.evaluation.pictures import contact_sheet
from echoavatar_lab.evaluation.takes import Sound, read_sounds

SECONDS, MIXED_LEVEL = 20.0, 0.35  # music under speech
SIZE, SMALL = (150, 210), (90, 126)


def mixtures(sounds: Sequence[Sound], count: int) -> list[Sound]:
    """Each of the first voices over one of the first tracks, which is turned down."""
    voices = [sound for sound in sounds if sound.kind == SPEECH][:count]
    tracks = [sound for sound in sounds if sound.kind == MUSIC][:count]
    mixed = []
    for voice, track in zip(voices, tracks, strict=True):
        length = min(len(voice.audio), len(track.audio))
        audio = 0.7 * voice.audio[:length] + MIXED_LEVEL * track.audio[:length]
        mixed.append(Sound(f"{voice.name} over {track.name}", "mixture", "", audio.astype(np.float32)))
    return mixed


def save(picture: UInt8[np.ndarray, "h w 3"], path: Path) -> None:
    """Write a WebP picture."""
    Image.fromarray(picture).save(path, quality=70, method=6)


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="default", help="bundle (default: default)")
    parser.add_argument("--recordings", type=Path, required=True, help="folder of speech and music with a manifest")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--grid", type=Path, help="picture with one row for each sound")
    parser.add_argument("--count", type=int, default=10, help="voices, and tracks (default: 10)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    sounds = read_sounds(args.recordings, SECONDS, args.count)
    sounds += mixtures(sounds, 2)
    done = animate_many(
        Pipeline(load_bundle(args.model)),
        [sound.audio[: int(SECONDS * SAMPLE_RATE_HZ)] for sound in sounds],
        seeds=range(args.seed, args.seed + len(sounds)),
    )
    rows = []
    for number, (sound, made) in enumerate(zip(tqdm(sounds, unit="sound", disable=None), done, strict=True), 1):
        name = re.sub(r"[^A-Za-z0-9]+", "-", sound.name).strip("-")
        save(contact_sheet(made.motion, size=SIZE), args.output / f"{number:02d}_{sound.kind}_{name}.webp")
        rows.append(contact_sheet(made.motion, columns=12, rows=1, size=SMALL))
    if args.grid:
        save(np.concatenate(rows), args.grid)


if __name__ == "__main__":
    main()
