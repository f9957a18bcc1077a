import numpy as np

from echoavatar.files.avatar import shading


def test_the_body_is_nearest_where_it_touches_the_floor() -> None:
    """Cells of 1.5 cm; a point on the floor, and one 20 cm above it."""
    contact_map = np.array([[64, 64], [64, 64]], np.float32)
    near = []
    for height in (0.0, 0.2):
        contact = np.ones((128, 128), np.float32)
        shading.nearness(np.array([[0.3, height, -0.2]], np.float32), contact, contact_map)
        assert np.argwhere(contact).tolist() == [[64 - 13, 64 + 19]]
        near.append(contact.sum())
    assert near[0] == 1
    assert 0 < near[1] < 0.3
