"""Makes the small pictures of the shipped characters that the live page's menu shows: web/app/public/faces/NAME.webp.

Run it after the characters have changed, and build the page again (`make web`).
"""

from pathlib import Path

import numpy as np
from PIL import Image

from echoavatar.files.avatar import CHARACTERS, load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.motion.kinematics import HUMANOID

TARGET = Path(__file__).parents[1] / "web/app/public/faces"
PIXELS = 96


def main() -> None:
    """Draw each face at rest."""
    TARGET.mkdir(parents=True, exist_ok=True)
    turns = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
    for name in CHARACTERS:
        renderer = AvatarRenderer(load_character(name), Shot(size=(PIXELS, PIXELS), view="face", samples=3))
        picture = Image.fromarray(renderer.draw(turns, HUMANOID.rest_positions))
        picture.save(TARGET / f"{name}.webp", quality=80, method=6)


if __name__ == "__main__":
    main()
