from pathlib import Path

import av
import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer
from echoavatar.files.avatar.framing import View
from echoavatar.files.avatar.video import Shot, film, write_film
from echoavatar.motion.kinematics import HUMANOID, Motion


def standing(frames: int) -> Motion:
    turns = np.zeros((frames, 52, 4), np.float32)
    turns[..., 0] = 1
    for side, sign in (("left", -1), ("right", 1)):
        turns[:, HUMANOID.index(f"{side}UpperArm")] = [np.cos(0.6), 0, 0, sign * np.sin(0.6)]
    root = np.tile(HUMANOID.rest_positions[0], (frames, 1))
    return Motion(HUMANOID, turns, root, 30.0)


@pytest.mark.parametrize("name", ["clip.mp4", "10:30.mp4"])
def test_picture_and_sound_have_the_same_length_and_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """15 frames at 30 fps and 12,000 samples at 24 kHz are half a second each. A colon makes no address of a name."""
    monkeypatch.chdir(tmp_path)
    path = Path(name)
    write_film(path, standing(15), np.sin(np.arange(12_000) / 20).astype(np.float32), shot=Shot((96, 96), samples=1))
    with av.open(f"file:{path}") as container:
        assert sum(1 for _ in container.decode(video=0)) == 15
        assert container.streams.video[0].average_rate == 30
    with av.open(f"file:{path}") as container:
        sound = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(audio=0)])
    assert abs(len(sound) / 48_000 - 0.5) < 0.05
    assert np.abs(sound).max() > 0.5


def test_the_encoder_does_not_count_cores(tmp_path: Path) -> None:
    """Nor does the file depend on their number; x264 writes its settings into it."""
    path = tmp_path / "clip.mp4"
    write_film(path, standing(2), np.zeros(1600, np.float32), shot=Shot((32, 32), samples=1))
    assert b" threads=1 " in path.read_bytes()


def test_the_character_stands_in_the_picture() -> None:
    picture = next(film(standing(1), shot=Shot((96, 160), samples=1)))
    background = picture[:20].reshape(-1, 3).astype(int)
    assert np.abs(picture[70, 48].astype(int) - background.mean(0)).sum() > 60


def test_a_close_up_shows_the_face_and_what_it_does() -> None:
    """The jaw's drop changes pixels below the middle of the picture and hardly any at the forehead."""
    shut, wide = np.zeros((1, 52), np.float32), np.zeros((1, 52), np.float32)
    wide[0, 17] = 1
    one, other = (
        next(film(standing(1), face=face, shot=Shot((96, 96), "face", samples=1))).astype(int) for face in (shut, wide)
    )
    changed = np.abs(one - other).sum(2) > 30
    assert changed[48:].sum() > 100
    assert changed[:30].sum() == 0


def test_a_face_of_another_length_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="2 frames take"):
        write_film(
            tmp_path / "clip.mp4",
            standing(2),
            np.zeros(1600, np.float32),
            face=np.zeros((5, 52), np.float32),
            shot=Shot((32, 32), samples=1),
        )


def test_an_unwritable_place_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="cannot write"):
        write_film(
            tmp_path / "no" / "clip.mp4", standing(2), np.zeros(1600, np.float32), shot=Shot((32, 32), samples=1)
        )
    assert list(tmp_path.iterdir()) == []


def test_a_webm_keeps_the_alpha_channel(tmp_path: Path) -> None:
    """Corners are clear, the body is opaque; read by libvpx, because FFmpeg's own decoder drops alpha."""
    path = tmp_path / "clip.webm"
    write_film(path, standing(3), np.zeros(2400, np.float32), shot=Shot((96, 160), alpha=True, samples=1))
    with av.open(str(path)) as container:
        decoder = av.CodecContext.create("libvpx-vp9", "r")
        packet = next(packet for packet in container.demux(video=0) if packet.size)
        frame = decoder.decode(packet)[0]
    assert frame.format.name == "yuva420p"
    alpha = frame.reformat(format="rgba").to_ndarray()[..., 3]
    assert alpha[:4].max() < 20
    assert alpha[70, 48] > 235


def test_a_format_without_alpha_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match=r"write \.webm"):
        write_film(tmp_path / "clip.mp4", standing(1), np.zeros(800, np.float32), shot=Shot((32, 32), alpha=True))


@pytest.mark.parametrize("size", [(161, 120), (160, 121), (0, 120), (160, -2)])
def test_an_odd_or_empty_size_is_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    """Two by two pixels share a colour: beside the last one there is no memory to read or to write."""
    with pytest.raises(MotionError, match=f"{size[0]} x {size[1]} pixels cannot be; width and height are even"):
        write_film(tmp_path / "clip.webm", standing(2), np.zeros(0, np.float32), shot=Shot(size))


def test_two_threads_draw_the_frames_in_order() -> None:
    """The jaw opens frame by frame; each picture is the one that a single renderer draws of this frame."""
    face = np.zeros((9, 52), np.float32)
    face[:, 17] = np.linspace(0, 1, 9)
    shot = Shot((64, 64), "face", samples=1)
    pictures = list(film(standing(9), face=face, shot=shot))
    alone = [next(film(standing(1), face=face[i : i + 1], shot=shot)) for i in range(9)]
    np.testing.assert_array_equal(pictures, alone)


def test_a_fault_of_the_renderer_ends_the_film(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that wait for a renderer get one, and fail too."""

    def failing(*_: object) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(AvatarRenderer, "draw", failing)
    with pytest.raises(MemoryError, match="no room"):
        list(film(standing(9), shot=Shot((160, 120), samples=1)))


@pytest.mark.parametrize("view", ["front", "bust"])
def test_the_film_holds_the_pictures_that_are_drawn(tmp_path: Path, view: View) -> None:
    """Only the drawn part is converted for the encoder: luma of whole pictures, apart from losses of the encoder."""
    path, shot = tmp_path / "clip.mp4", Shot((160, 120), view, samples=1)
    write_film(path, standing(2), np.zeros(1600, np.float32), shot=shot)
    weights = np.array([0.257, 0.504, 0.098])  # of red, green and blue in luma
    with av.open(str(path)) as container:
        for frame, picture in zip(container.decode(video=0), film(standing(2), shot=shot), strict=True):
            luma = frame.to_ndarray()[:120]
            assert np.abs(luma - (picture @ weights + 16)).mean() < 2
