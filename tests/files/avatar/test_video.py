from pathlib import Path

import av
import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar.video import film, write_mp4
from echoavatar.motion.kinematics import HUMANOID, Motion


def standing(frames: int) -> Motion:
    turns = np.zeros((frames, 52, 4), np.float32)
    turns[..., 0] = 1
    turns[:, HUMANOID.index("leftUpperArm")] = [np.cos(0.6), 0, 0, -np.sin(0.6)]
    root = np.tile(HUMANOID.rest_positions[0].numpy(), (frames, 1))
    return Motion(HUMANOID, turns, root, 30.0)


def test_picture_and_sound_have_the_same_length_and_rate(tmp_path: Path) -> None:
    """15 frames at 30 fps and 12,000 samples at 24 kHz are half a second each."""
    path = tmp_path / "clip.mp4"
    write_mp4(path, standing(15), np.sin(np.arange(12_000) / 20).astype(np.float32), size=(96, 96), samples=1)
    with av.open(str(path)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 15
        assert container.streams.video[0].average_rate == 30
    with av.open(str(path)) as container:
        sound = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(audio=0)])
    assert abs(len(sound) / 48_000 - 0.5) < 0.05
    assert np.abs(sound).max() > 0.5


def test_the_character_stands_in_the_picture() -> None:
    picture = next(film(standing(1), size=(96, 160), samples=1))
    background = picture[:20].reshape(-1, 3).astype(int)
    assert np.abs(picture[80, 48].astype(int) - background.mean(0)).sum() > 60


def test_a_close_up_shows_the_face_and_what_it_does() -> None:
    """The jaw's drop changes pixels below the middle of the picture and hardly any at the forehead."""
    shut, wide = np.zeros((1, 52), np.float32), np.zeros((1, 52), np.float32)
    wide[0, 17] = 1
    one, other = (
        next(film(standing(1), face=face, size=(96, 96), samples=1, view="face")).astype(int) for face in (shut, wide)
    )
    changed = np.abs(one - other).sum(2) > 30
    assert changed[48:].sum() > 100
    assert changed[:30].sum() == 0


def test_a_face_of_another_length_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="2 frames take"):
        write_mp4(
            tmp_path / "clip.mp4",
            standing(2),
            np.zeros(1600, np.float32),
            face=np.zeros((5, 52), np.float32),
            size=(32, 32),
            samples=1,
        )


def test_an_unwritable_place_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="cannot write"):
        write_mp4(tmp_path / "no" / "clip.mp4", standing(2), np.zeros(1600, np.float32), size=(32, 32), samples=1)
    assert list(tmp_path.iterdir()) == []
