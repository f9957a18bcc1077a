"""Films of two bundles for readers who do not know which is which: the same voices and seeds, in an order drawn by lot.

    python scripts/blind_films.py OLD NEW --recordings RECORDINGS -o blind              # 12 voices of split dev
    python scripts/blind_films.py OLD NEW --recordings RECORDINGS -o blind --split test # for a release, once

OLD may also be a folder of BVH files, `01.bvh` for the first voice: what another version made of it, with the seeds 0,
1, 2 and so on. `--voices FOLDER` writes the voices for it, `01.wav` and on, and ends.
RECORDINGS is a folder as `echoavatar evaluate BUNDLE jury` reads it (docs/metrics.md). Each voice gives two sheets of
20 s, `NN_first.webp` and `NN_second.webp`, with six stills a second, one second a row, two seconds side by side; the
camera follows the hips. `key.json` tells which bundle made each sheet: keep it from the readers.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import soundfile
from PIL import Image

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.motion.formats.bvh import read_bvh
from echoavatar.motion.kinematics import Motion
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.evaluation.metrics.liveliness import SPEECH
from echoavatar_lab.evaluation.pictures import contact_sheet
from echoavatar_lab.evaluation.takes import read_sounds

SECONDS, RATE, SIZE = 20, 6, (120, 160)


def performed(bundle: str, audio: list[np.ndarray], first_seed: int) -> list[Motion]:
    """What a bundle makes of each voice, or what a folder of BVH files has of it."""
    if (Path(bundle) / "01.bvh").exists():
        return [read_bvh(Path(bundle) / f"{number + 1:02d}.bvh") for number in range(len(audio))]
    seeds = range(first_seed, first_seed + len(audio))
    return [one.motion for one in animate_many(Pipeline(load_bundle(bundle)), audio, seeds=seeds)]


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundles", nargs=2, metavar="BUNDLE")
    parser.add_argument("--recordings", type=Path, required=True, help="folder of speech with a manifest")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--split", choices=["dev", "test"], default="dev")
    parser.add_argument("--count", type=int, default=12, help="voices (default: 12)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--voices", type=Path, metavar="FOLDER", help="only write the voices, as WAV, here")
    args = parser.parse_args()
    folder = args.voices or args.output
    folder.mkdir(parents=True, exist_ok=True)
    sounds = [sound for sound in read_sounds(args.recordings, 30, args.count, split=args.split) if sound.kind == SPEECH]
    audio = [sound.audio[: SECONDS * SAMPLE_RATE_HZ] for sound in sounds]
    if args.voices:
        for number, voice in enumerate(audio):
            soundfile.write(args.voices / f"{number + 1:02d}.wav", voice, SAMPLE_RATE_HZ)
        return
    made = [performed(bundle, audio, args.seed) for bundle in args.bundles]
    first = np.random.default_rng(args.seed).permutation(np.arange(len(sounds)) % 2)  # each bundle first in a half
    key = {}
    for number, order in enumerate(first):
        for place, who in (("first", order), ("second", 1 - order)):
            sheet = contact_sheet(
                made[who][number], columns=2 * RATE, rows=SECONDS // 2, every=FRAME_RATE_HZ // RATE, size=SIZE
            )
            name = f"{number + 1:02d}_{place}.webp"
            Image.fromarray(sheet).save(args.output / name, quality=70, method=6)
            key[name] = {"bundle": args.bundles[who], "voice": sounds[number].name}
    (args.output / "key.json").write_text(json.dumps(key, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
