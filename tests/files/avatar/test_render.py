import numpy as np

from echoavatar.files.avatar.render import Camera, Renderer, Surface


def square(z: float = 0.0, *, colour: tuple[float, float, float] = (1.0, 0.0, 0.0), flip: bool = False) -> Surface:
    """A square metre one metre above the floor, facing +Z (or away)."""
    points = np.array([[-0.5, 0.6, z], [0.5, 0.6, z], [0.5, 1.6, z], [-0.5, 1.6, z]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return Surface(
        points, np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile(colour, (4, 1)), triangles[:, ::-1] if flip else triangles
    )


def joined(*surfaces: Surface) -> Surface:
    first = np.cumsum([0, *(len(s.points) for s in surfaces)])
    return Surface(
        *(np.concatenate([getattr(s, name) for s in surfaces]) for name in ("points", "normals", "colours")),
        np.concatenate([s.triangles + at for s, at in zip(surfaces, first, strict=False)]),
    )


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


def test_a_body_casts_a_shadow_on_the_floor() -> None:
    camera = Camera(position=(0.0, 3.0, 3.0), target=(0.0, 0.0, -0.5), field_of_view=0.9)
    far = square(50.0)
    near = Renderer(96, 96, camera=camera).draw(square()).astype(int)
    empty = Renderer(96, 96, camera=camera).draw(far).astype(int)
    darker = (near.sum(2) < empty.sum(2) - 25) & ~np.apply_along_axis(is_red, 2, near)
    assert darker.sum() > 100


def test_supersampling_smooths_edges() -> None:
    """A hard edge has two tones; a smoothed one has tones in between."""
    hard = Renderer(96, 96, camera=CAMERA, samples=1).draw(square())[48, :, 0]
    soft = Renderer(96, 96, camera=Camera((0.05, 1.1, 4.0), (0.05, 1.1, 0.0), 0.6), samples=3).draw(square())[48, :, 0]
    assert len(np.unique(soft)) >= len(np.unique(hard))
