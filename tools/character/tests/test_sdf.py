import numpy as np
import pytest

from echoavatar_character import sdf


def points(count: int = 200) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


def test_sphere_and_cone_are_exact_distances() -> None:
    """A cone of two equal radii is a capsule: beside its middle, distance = offset - radius."""
    p = np.array([[0.5, 0.3, 0.0], [2.0, 0.0, 0.0]])
    np.testing.assert_allclose(sdf.rounded_cone(p, (0, 0, 0), (1, 0, 0), 0.1, 0.1), [0.2, 0.9])
    np.testing.assert_allclose(sdf.sphere(p, (2, 0, 0), 0.5)[1], -0.5)


def test_ellipsoid_with_equal_radii_is_a_sphere() -> None:
    p = points()
    np.testing.assert_allclose(sdf.ellipsoid(p, (0, 0, 0), (0.4, 0.4, 0.4)), sdf.sphere(p, (0, 0, 0), 0.4), atol=1e-9)


def test_smooth_min_lies_below_both_and_is_sharp_far_from_the_seam() -> None:
    a, b = np.array([0.0, 1.0, 0.02]), np.array([1.0, 0.0, 0.0])
    blended = sdf.smooth_min(a, b, 0.1)
    assert (blended <= np.minimum(a, b)).all()
    np.testing.assert_allclose(blended[:2], 0.0)
    assert blended[2] < -0.01  # (0.1 - 0.02)^2 / 0.1 / 4 = 0.016 below


def test_carving_removes_what_the_tool_covers() -> None:
    p = np.array([[0.0, 0, 0], [0.45, 0, 0]])
    left = sdf.carve(sdf.sphere(p, (0, 0, 0), 0.5), sdf.sphere(p, (0.5, 0, 0), 0.3), 0.01)
    assert left[0] < 0 < left[1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_loft_of_constant_circles_is_a_cylinder(axis: int) -> None:
    p = points() * 0.3
    d = sdf.loft(p, axis, [(-2, 0.2, 0.1, 0.2, 0.0), (2, 0.2, 0.1, 0.2, 0.0)])
    u, v = (i for i in range(3) if i != axis)
    np.testing.assert_allclose(d, np.hypot(p[:, u] - 0.1, p[:, v]) - 0.2, atol=1e-9)


def test_projection_lands_on_the_surface_with_outward_normals() -> None:
    def field(p: np.ndarray) -> np.ndarray:
        return sdf.ellipsoid(p, (0, 0, 0), (0.3, 0.5, 0.4))

    landed = sdf.project(field, points() * 0.1 + [0.3, 0, 0], passes=6)
    assert np.abs(field(landed)).max() < 1e-5
    exact = landed / np.square([0.3, 0.5, 0.4])
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert (np.einsum("ni,ni->n", sdf.gradient(field, landed), exact) > 0.9999).all()


def test_curve_passes_its_ends_and_never_thins_below_its_rows() -> None:
    rows = [(0, 0, 0, 0.01), (1, 1, 0, 0.02), (2, 0, 0, 0.005)]
    bent = np.asarray(sdf.curve(rows, 9))
    np.testing.assert_allclose(bent[[0, -1]], [rows[0], rows[-1]])
    assert bent[:, 3].min() >= 0.005
