import numpy as np

from echoavatar_character.face_bake import face_morphs, neutral
from echoavatar_character.figure_mouth import line
from echoavatar_character.sculpt import Mesh


def sheet() -> Mesh:
    """A curtain in front of the modelled mouth, facing +Z; its triangles do not matter here."""
    x, y = (a.reshape(-1) for a in np.meshgrid(np.linspace(-0.03, 0.03, 13), np.linspace(1.50, 1.54, 17)))
    points = np.stack([x, y, np.full_like(x, 0.09)], 1).astype(np.float32)
    return Mesh(points, np.tile(np.float32([0, 0, 1]), (len(x), 1)), np.zeros((0, 3), np.int32))


def test_the_neutral_head_keeps_order_and_sides() -> None:
    mesh, side = neutral(sheet())
    assert set(side) == {-1.0, 1.0}
    height = mesh.positions[:, 1] - line(mesh.positions[:, 0])
    assert (height * side > -0.0037).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_all_shapes_are_made_on_all_parts() -> None:
    mesh, side = neutral(sheet())
    morphs = face_morphs([("skin", mesh, side), ("tongue", sheet(), np.ones(len(side)))])
    assert len(morphs.names) == 52
    tongue = morphs.vertices[morphs.part(morphs.names.index("tongueOut"))]
    assert tongue.max() >= len(side)
