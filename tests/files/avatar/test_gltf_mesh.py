import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf_buffer import Buffer
from echoavatar.files.avatar.gltf_mesh import meshes


def test_only_the_face_s_own_vertices_carry_targets() -> None:
    """Each material of the face has its own vertices: together they are those within reach of the shapes."""
    character = load_character()
    buffer = Buffer()
    body, face = meshes(buffer, character)
    counts = [buffer.accessors[primitive["attributes"]["POSITION"]]["count"] for primitive in face["primitives"]]
    on_face = character.triangles[character.triangles[:, 0] < character.face.reach]
    assert sum(counts) == len(np.unique(on_face))
    assert len({primitive["attributes"]["POSITION"] for primitive in body["primitives"]}) == 1
