import numpy as np

from echoavatar.files.avatar import shading


def test_the_contact_shadow_lies_under_what_touches_the_floor_and_fades_with_height() -> None:
    """Cells of 1.5 cm; a point on the floor, and one 20 cm above it."""
    contact_map = np.array([[64, 64], [64, 64]], np.float32)
    dark = []
    for height in (0.0, 0.2):
        contact = np.zeros((128, 128), np.float32)
        points = np.array([[0.3, height, -0.2]], np.float32)
        shading.contact_shadow(points, contact, contact_map, np.zeros(128, np.float32))
        assert np.unravel_index(contact.argmax(), contact.shape) == (64 - 13, 64 + 19)
        dark.append(contact.sum())
    assert abs(dark[0] - 1) < 1e-4  # the blur moves what is dark and adds none
    assert 0 < dark[1] < 0.3
