"""The same pictures as `Renderer`, here by whatever OpenGL there is: a card, or Mesa's software."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from echoavatar.errors import DependencyError, MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.files.avatar.gpu_render import GpuRenderer
from echoavatar.files.avatar.render import Renderer, Surface
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion

from .test_render import CAMERA, is_red, painted, square


@pytest.fixture(scope="module")
def opengl() -> None:
    """Skips where there is none."""
    try:
        GpuRenderer(8, 8)
    except DependencyError as error:
        pytest.skip(str(error))


drawn = pytest.mark.usefixtures("opengl")


def posed(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Every joint turned a little, at random."""
    turns = np.random.default_rng(seed).standard_normal((HUMANOID.joints, 4)) * 0.06
    turns[:, 0] = 1
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    world = forward_kinematics(HUMANOID, matrix_from_quaternion(turns), HUMANOID.rest_positions[0])
    return world.rotations, world.positions


@drawn
@pytest.mark.parametrize(
    ("view", "background", "alpha", "most"),
    [
        ("front", "studio", False, 1.65),
        ("bust", "dusk", False, 1.3),
        ("face", "#00ff00", False, 2.1),
        ("back", "plain", True, 1.25),
    ],
)
def test_it_draws_what_the_processor_draws(view, background, alpha, most) -> None:
    """`most` is a tenth above what was seen. Without any one of light, shadow, highlight, picture or its reductions,
    or the floor's darkening, some view differs by more."""
    shot = Shot((192, 192), view, background, alpha)
    first = AvatarRenderer(load_character(), shot)
    second = AvatarRenderer(load_character(), replace(shot, renderer="gpu"), first.paint)
    for seed in range(2):
        ours, theirs = (renderer.draw(*posed(seed)).astype(int) for renderer in (first, second))
        assert ours.shape == theirs.shape
        is_body = np.abs(ours - first._renderer._empty).max(2) > 8  # and its shadow
        assert np.abs(ours - theirs)[is_body].mean() < most
        assert np.abs(ours - theirs)[~is_body].mean() < 0.05


@drawn
def test_a_cut_out_picture_is_seen_from_both_sides_where_it_is_opaque() -> None:
    for flip in (False, True):
        triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        surface = replace(square(), paint=painted((1.0, 1.0, 1.0), triangles[:, ::-1] if flip else triangles, 0))
        picture = GpuRenderer(64, 64, camera=CAMERA).draw(surface)
        assert is_red(picture[25, 32])
        assert not is_red(picture[40, 32])


@drawn
def test_what_faces_away_is_not_drawn_and_other_paint_takes_the_place_of_the_first() -> None:
    renderer = GpuRenderer(64, 64, camera=CAMERA)
    assert is_red(renderer.draw(square())[32, 32])
    assert not is_red(renderer.draw(square(flip=True))[32, 32])


@drawn
@pytest.mark.parametrize("samples", [1, 3])
def test_edges_lie_where_the_processor_puts_them(samples) -> None:
    """Alpha is the share of a pixel that is covered."""
    alphas = [
        make(64, 64, camera=CAMERA, samples=samples, alpha=True).draw(square())[:50, :, 3].astype(int)
        for make in (Renderer, GpuRenderer)
    ]
    assert np.abs(alphas[0] - alphas[1]).mean() < 1
    assert alphas[1].max() == 255


@drawn
def test_any_thread_draws_and_two_renderers_draw_at_once() -> None:
    first = AvatarRenderer(load_character(), Shot((64, 64), "bust", samples=1, renderer="gpu"))
    second, pose = first.twin(), posed(0)
    expected = first.draw(*pose)
    with ThreadPoolExecutor(2) as threads:
        for pair in ((first, second), (second, first)):
            for picture in threads.map(lambda renderer: renderer.draw(*pose), pair):
                np.testing.assert_array_equal(picture, expected)


def test_there_is_no_such_background() -> None:
    with pytest.raises(MotionError, match="no background 'beach'"):
        GpuRenderer(8, 8, background="beach")


def test_without_opengl_the_error_says_what_failed_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("moderngl", reason="pip install 'echoavatar[gpu]'")
    monkeypatch.setenv("GLCONTEXT_LINUX_LIBEGL", "/nowhere/libEGL.so")
    with pytest.raises(DependencyError, match="EGL.*nowhere.*libegl1.*cpu"):
        GpuRenderer(8, 8)


@drawn
def test_a_card_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLCONTEXT_DEVICE_INDEX", "99")
    with pytest.raises(DependencyError, match="99.*found"):
        GpuRenderer(8, 8)


def test_without_moderngl_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(DependencyError, match=r"echoavatar\[gpu\]"):
        GpuRenderer(8, 8)


@drawn
def test_a_surface_out_of_sight_leaves_the_stage() -> None:
    renderer = GpuRenderer(64, 64, camera=CAMERA, background="#102030")
    far = square(50.0)
    picture = renderer.draw(Surface(far.points, far.normals, far.paint))
    assert (np.abs(picture.astype(int) - [16, 32, 48]) <= 1).all()
