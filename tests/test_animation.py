"""Three lines of Python, and a notebook that runs them."""

import re
from pathlib import Path

import av
import numpy as np
import pytest
import soundfile

import echoavatar
from echoavatar.files.exports import read_take


@pytest.fixture(scope="module")
def animation(tmp_path_factory: pytest.TempPathFactory, tiny_bundle: Path) -> echoavatar.Animation:
    path = tmp_path_factory.mktemp("sound") / "talk.wav"
    soundfile.write(path, 0.1 * np.sin(np.arange(24_000) / 20), 24_000)
    return echoavatar.animate(path, model=tiny_bundle, seed=3)


def test_a_file_and_its_samples_give_the_same_motion(animation: echoavatar.Animation, tiny_bundle: Path) -> None:
    again = echoavatar.animate((animation.audio * 32_767).astype(np.int16), model=tiny_bundle, seed=3)
    assert again.motion.frames == animation.motion.frames == 30
    np.testing.assert_allclose(again.motion.rotations, animation.motion.rotations, atol=1e-3)
    slower = echoavatar.animate(np.zeros((8_000, 2), np.float32), rate=16_000, fps=12.5, model=tiny_bundle)
    assert (slower.motion.frames, slower.motion.fps) == (7, 12.5)


def test_it_saves_in_any_format_and_as_arrays(animation: echoavatar.Animation, tmp_path: Path) -> None:
    for name in ("talk.glb", "talk.bvh", "talk.npz", "talk.vrma"):
        animation.save(tmp_path / name)
    assert (tmp_path / "talk.glb").read_bytes()[:4] == b"glTF"
    np.testing.assert_array_equal(read_take(tmp_path / "talk.npz").motion.root, animation.motion.root)
    arrays = animation.to_numpy()
    assert arrays["rotations"].shape == (30, 52, 4)
    assert len(arrays["joints"]) == len(arrays["parents"]) == 52
    assert arrays["audio"].shape == (24_000,)
    with pytest.raises(echoavatar.EchoAvatarError, match="use one of"):
        animation.save(tmp_path / "talk.doc")


def test_a_film_has_the_size_and_the_side_asked_for(animation: echoavatar.Animation, tmp_path: Path) -> None:
    pictures = {}
    for view in ("front", "back", "left", "face"):
        animation.save(tmp_path / f"{view}.mp4", size=(128, 96), view=view)
        with av.open(str(tmp_path / f"{view}.mp4")) as film:
            pictures[view] = next(film.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    assert all(picture.shape == (96, 128, 3) for picture in pictures.values())
    for view in ("back", "left", "face"):
        assert np.abs(pictures[view] - pictures["front"]).mean() > 1


def test_a_film_has_the_shape_asked_for(animation: echoavatar.Animation, tmp_path: Path) -> None:
    few = echoavatar.Animation(animation.motion.cut(0, 1), animation.audio[:800], 0.0)
    few.save(tmp_path / "a.mp4", size="portrait")
    with av.open(str(tmp_path / "a.mp4")) as film:
        assert (film.streams.video[0].width, film.streams.video[0].height) == (720, 1280)
    with pytest.raises(echoavatar.EchoAvatarError, match="no size 'tall'; choose wide, portrait, square"):
        few.save(tmp_path / "b.mp4", size="tall")


def test_printed_it_says_what_it_holds_in_a_line(animation: echoavatar.Animation) -> None:
    assert animation.seconds == animation.motion.seconds == 1.0
    assert str(animation).startswith("Animation of 1.00 s: 30 frames at 30 fps, 52 joints, ")
    assert "\n" not in f"{animation!r}"


def test_a_notebook_shows_a_page_of_its_own(animation: echoavatar.Animation) -> None:
    shown = animation._repr_html_()
    assert re.match(r'<iframe [^>]*srcdoc="', shown)
    assert "&lt;script" in shown
    assert not re.search(r"(src|href)=&quot;https?:", shown)
