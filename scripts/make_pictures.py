"""Make the README's animated picture: three people speak and dance to the bundled sounds.

    python scripts/make_pictures.py     # or `make pictures`; writes docs/pictures/speech_and_music.webp, about a minute

Needs the extras `render`. What it shows is what the default bundle makes of the sounds with one seed, cut by nothing.
"""

from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from echoavatar.engine import animate
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.video import Shot, View, film
from echoavatar.models.audio import stream_audio

SHIPPED = Path(__file__).parents[1] / "docs" / "pictures" / "speech_and_music.webp"
HEIGHT = 340
PANELS: tuple[tuple[str, str, float, View, int], ...] = (
    ("speech.ogg", "amara", 4.0, "front", 240),
    ("music.ogg", "theo", 14.0, "front", 260),
    ("speech.ogg", "maya", 4.0, "face", 380),
)  # sound, who, where it begins in seconds, view, width
SECONDS, EVERY, SEED = 7.0, 3, 3  # every third frame is shown: 10 a second


def panel(
    pipeline: Pipeline, sound: str, who: str, begin: float, view: View, width: int
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """The pictures of one person, drawn twice as large as they are shown."""
    done = animate(pipeline, stream_audio(Path(str(files("echoavatar") / "assets" / sound))), seed=SEED)
    first = round(begin * done.motion.fps)
    shown = slice(first, first + round(SECONDS * done.motion.fps), EVERY)
    face = None if done.face is None else done.face[shown]
    motion = replace(
        done.motion, rotations=done.motion.rotations[shown], root=done.motion.root[shown], fps=done.motion.fps / EVERY
    )
    shot = Shot((2 * width, 2 * HEIGHT), view)
    for large in film(motion, face=face, character=load_character(who), shot=shot):
        yield np.asarray(Image.fromarray(large).resize((width, HEIGHT), Image.Resampling.BILINEAR))


def main() -> None:
    """Write the picture."""
    pipeline = Pipeline(load_bundle("default"))
    rows = zip(*(panel(pipeline, *chosen) for chosen in PANELS), strict=True)
    pictures = [Image.fromarray(np.concatenate(row, axis=1)) for row in islice(rows, round(SECONDS * 30 / EVERY))]
    SHIPPED.parent.mkdir(exist_ok=True)
    pictures[0].save(SHIPPED, save_all=True, append_images=pictures[1:], duration=100, loop=0, quality=60, method=4)
    print(f"wrote {SHIPPED}: {len(pictures)} pictures, {SHIPPED.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
