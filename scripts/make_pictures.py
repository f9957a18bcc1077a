"""Make the README's animated picture: people speak, dance and do what is asked, and a close-up.

    python scripts/make_pictures.py     # or `make pictures`; writes docs/pictures/speech_and_music.webp, about a minute

Needs the extras `render`. What it shows is what the default bundle makes of the sounds with one seed, cut by nothing.
"""

from collections.abc import Iterator
from importlib.resources import files
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.framing import View
from echoavatar.files.avatar.video import Shot, film
from echoavatar.models.audio import stream_audio
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.motion_chunk import join
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ

SHIPPED = Path(__file__).parents[1] / "docs" / "pictures" / "speech_and_music.webp"
HEIGHT = 340
PANELS: tuple[tuple[str, str, float, View, int, str], ...] = (
    ("speech.ogg", "amara", 4.0, "front", 220, ""),
    ("music.ogg", "theo", 14.0, "front", 240, ""),
    ("speech.ogg", "maya", 4.0, "front", 220, "raise_both_hands"),
    ("speech.ogg", "maya", 4.0, "face", 300, ""),
)  # sound, who, where it begins in seconds, view, width, an action asked for ACTION_S later
ACTION_S = 1.5
SECONDS, EVERY, SEED = 7.0, 3, 2  # every third frame is shown: 10 a second


def panel(
    pipeline: Pipeline, sound: str, who: str, begin: float, view: View, width: int, action: str
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """The pictures of one person, drawn twice as large as they are shown."""
    heard = np.concatenate(list(stream_audio(Path(str(files("echoavatar") / "assets" / sound)))))
    first, asked = round(begin * FRAME_RATE_HZ), round((begin + ACTION_S) * SAMPLE_RATE_HZ)
    with Engine(pipeline, rewind=0).open(seed=SEED) as session:
        session.push(heard[:asked])
        chunks = list(session)
        if action:
            session.act(action)
        session.push(heard[asked : round((begin + SECONDS + 1) * SAMPLE_RATE_HZ)])
        session.finish()
        done = join([*chunks, *session])
    shown = slice(first, first + round(SECONDS * FRAME_RATE_HZ), EVERY)
    face = None if done.face is None else done.face[shown]
    motion = Motion(pipeline.skeleton, done.rotations[shown], done.root[shown], FRAME_RATE_HZ / EVERY)
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
