import numpy as np
import pytest

from echoavatar_character.sdf import sphere
from echoavatar_character.symmetric import CloseUp, sculpt_symmetric

pytest.importorskip("skimage", reason="the character extra is not installed")
pytest.importorskip("fast_simplification", reason="the character extra is not installed")


def ball(closeups: tuple[CloseUp, ...] = ()):  # type: ignore[no-untyped-def]
    return sculpt_symmetric(
        lambda p: sphere(p, (0, 0, 0), 0.1), (-0.13,) * 3, (0.13,) * 3, cell=0.004, triangles=800, closeups=closeups
    )


def test_both_halves_are_alike_welded_and_closed() -> None:
    mesh = ball()
    p = mesh.positions.astype(float)
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 0.1, atol=1e-4)
    gap = np.linalg.norm(p[:, None] - (p * [-1, 1, 1])[None], axis=2).min(0)
    assert gap.max() < 1e-7
    edges = np.sort(np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]))
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).mean() > 0.995
    a, b, c = (p[mesh.triangles[:, i]] for i in range(3))
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a + b + c) > 0).all()


def test_a_close_up_gets_more_triangles() -> None:
    def near(mesh) -> int:  # type: ignore[no-untyped-def]
        return int((np.linalg.norm(mesh.positions - [0, 0, 0.1], axis=1) < 0.04).sum())

    assert near(ball((CloseUp((0.0, 0.0, 0.1), 0.03, 3.0),))) > 1.3 * near(ball())
