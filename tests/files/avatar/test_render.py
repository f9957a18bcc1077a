from dataclasses import replace

import numpy as np
import pytest

from echoavatar.files.avatar import load_character, render
from echoavatar.files.avatar.character import Texels
from echoavatar.files.avatar.render import Camera, Paint, Renderer, Surface
from echoavatar.files.avatar.shading import softened


def square(z: float = 0.0, *, colour: tuple[float, float, float] = (1.0, 0.0, 0.0), flip: bool = False) -> Surface:
    """A square metre one metre above the floor, facing +Z (or away)."""
    points = np.array([[-0.5, 0.6, z], [0.5, 0.6, z], [0.5, 1.6, z], [-0.5, 1.6, z]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Surface(points, np.tile([0.0, 0.0, 1.0], (4, 1)), painted(colour, triangles[:, ::-1] if flip else triangles))


def painted(colour: tuple[float, float, float], triangles: np.ndarray, picture: int = -1) -> Paint:
    """One colour on all corners; picture 0 is opaque red above its middle and clear below."""
    values = np.zeros((4, 4, 4), np.uint8)
    values[:2] = [255, 0, 0, 255]
    table = np.tile(np.array([0, 4, 4]), (1, 6, 1))
    corners = int(triangles.max()) + 1
    return Paint(
        colours=np.tile(np.float32(colour), (corners, 1)),
        triangles=np.ascontiguousarray(triangles),
        uvs=np.tile(np.float32([[0, 1], [1, 1], [1, 0], [0, 0]]), (corners // 4, 1)),
        pictures=np.full(len(triangles), picture, np.int32),
        two_sided=np.full(len(triangles), picture >= 0),
        cutouts=np.full(len(triangles), picture, np.int32),
        sheer=np.zeros(len(triangles), bool),
        glosses=np.tile(np.float32([0.1, 20]), (len(triangles), 1)),
        texels=Texels(values.reshape(-1, 4), table),
    )


def joined(*surfaces: Surface) -> Surface:
    triangles = np.concatenate([s.paint.triangles + 4 * i for i, s in enumerate(surfaces)])
    paint = painted((0, 0, 0), triangles.astype(np.int32))
    colours = np.concatenate([s.paint.colours for s in surfaces])
    points, normals = (np.concatenate([getattr(s, name) for s in surfaces]) for name in ("points", "normals"))
    return Surface(points, normals, replace(paint, colours=colours))


CAMERA = Camera(position=(0.0, 1.1, 4.0), target=(0.0, 1.1, 0.0), field_of_view=0.6)


def is_red(pixel: np.ndarray) -> bool:
    return bool(pixel[0] > 2 * int(pixel[1]) + 20)


def test_a_square_appears_where_perspective_puts_it() -> None:
    """4 m away under 0.6 rad, one metre is 96 / (2 tan(0.3) 4) = 38.8 pixels of 96."""
    picture = Renderer(96, 96, camera=CAMERA).draw(square())
    row = np.array([is_red(pixel) for pixel in picture[48]])
    assert abs(row.sum() - 38.8) <= 2
    assert row[48]


def test_the_nearer_surface_hides_the_farther_one_whatever_the_order() -> None:
    red, blue = square(0.5), square(0.0, colour=(0.0, 0.0, 1.0))
    for surfaces in ((red, blue), (blue, red)):
        assert is_red(Renderer(64, 64, camera=CAMERA).draw(joined(*surfaces))[32, 32])


def test_what_faces_away_is_not_drawn() -> None:
    assert not is_red(Renderer(64, 64, camera=CAMERA).draw(square(flip=True))[32, 32])


def test_a_cut_out_picture_is_seen_from_both_sides_where_it_is_opaque() -> None:
    """The picture is red above its middle and clear below; the square spans rows 19 to 45 of 64."""
    for flip in (False, True):
        triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        surface = replace(square(), paint=painted((1.0, 1.0, 1.0), triangles[:, ::-1] if flip else triangles, 0))
        picture = Renderer(64, 64, camera=CAMERA).draw(surface)
        assert is_red(picture[25, 32])
        assert not is_red(picture[40, 32])


def test_a_shadow_of_contact_is_softened_by_means_of_nine_cells_thrice() -> None:
    cells = np.random.default_rng(0).random((40, 40)).astype(np.float32)
    mean = np.linalg.matrix_power((np.abs(np.subtract.outer(np.arange(40), np.arange(40))) <= 4) / 9, 3)
    wanted = mean @ cells @ mean
    softened(cells)
    np.testing.assert_allclose(cells, wanted, atol=1e-5)


def test_a_body_casts_a_shadow_on_the_floor() -> None:
    camera = Camera(position=(0.0, 3.0, 3.0), target=(0.0, 0.0, -0.5), field_of_view=0.9)
    far = square(50.0)
    near = Renderer(96, 96, camera=camera).draw(square()).astype(int)
    empty = Renderer(96, 96, camera=camera).draw(far).astype(int)
    darker = (near.sum(2) < empty.sum(2) - 25) & ~np.apply_along_axis(is_red, 2, near)
    assert darker.sum() > 100


def test_the_floor_is_darkened_only_between_the_columns_that_its_shadow_reaches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With all of the floor looked at there is nothing more to see; light falls from the right and the front."""
    camera = Camera(position=(0.0, 3.0, 6.0), target=(0.0, 0.0, -0.5), field_of_view=0.9)
    renderer = Renderer(128, 96, camera=camera)
    picture = renderer.draw(square()).astype(int)
    left, top, right, bottom = renderer.drawn[0]
    assert right - left < 100
    monkeypatch.setattr(render, "SPREAD_METRES", np.float32(9))
    assert np.abs(Renderer(128, 96, camera=camera).draw(square()) - picture).max() <= 1
    darker = picture.sum(2) < renderer.empty.astype(int).sum(2) - 25
    assert darker[top:bottom, left:right].sum() > 40


def test_a_row_of_more_samples_than_are_lit_at_once_has_no_seam() -> None:
    """Steps of brightness from column to column stay below two."""
    picture = Renderer(640, 64, camera=Camera((0.0, 1.1, 0.9), (0.0, 1.1, 0.0), 0.1), samples=3).draw(square())
    assert is_red(picture[32, 0])
    assert np.abs(np.diff(picture[32].astype(int), axis=0)).max() < 2


def test_a_pixel_of_more_samples_than_are_lit_at_once_is_drawn() -> None:
    assert is_red(Renderer(8, 8, camera=CAMERA, samples=24).draw(square())[4, 4])


@pytest.mark.parametrize("odd", [np.nan, np.inf, -1e30])
def test_damaged_normals_and_places_draw_a_picture_all_the_same(odd: float) -> None:
    """Tables are not read beside their ends, and nothing is written beside the picture."""
    surface = square()
    normals, points = surface.normals.copy(), surface.points.copy()
    normals[1:3], points[2, 0] = odd, odd
    for damaged in (replace(surface, normals=normals), replace(surface, points=points)):
        with np.errstate(invalid="ignore", over="ignore"):
            picture = Renderer(64, 64, camera=CAMERA).draw(damaged)
        np.testing.assert_array_equal(picture[0, :8], Renderer(64, 64).empty[0, :8])


def test_supersampling_smooths_edges() -> None:
    """A hard edge has two tones; a smoothed one has tones in between."""
    hard = Renderer(96, 96, camera=CAMERA, samples=1).draw(square())[48, :, 0]
    soft = Renderer(96, 96, camera=Camera((0.05, 1.1, 4.0), (0.05, 1.1, 0.0), 0.6), samples=3).draw(square())[48, :, 0]
    assert len(np.unique(soft)) >= len(np.unique(hard))


def test_hair_that_is_painted_on_skin_does_not_shine() -> None:
    """The scalp's triangles are the matt ones, and without a roughness map no triangle of skin is."""
    character = load_character()
    skin = character.materials[character.triangles[:, 0]] == 0
    matt = skin & (Paint.of(character).glosses[:, 0] == 0)
    heights = character.positions[character.triangles, 1].mean(1)
    assert 0.01 < matt.sum() / skin.sum() < 0.1
    assert np.median(heights[matt]) > np.percentile(heights[skin], 75)
    plain = Paint.of(replace(character, textures=character.textures | {"skin_roughness": b""}))
    assert (plain.glosses[skin, 0] > 0).all()
