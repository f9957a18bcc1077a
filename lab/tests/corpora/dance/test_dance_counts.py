import numpy as np

from echoavatar_lab.corpora.dance.dance_counts import find_counts


def test_counts_are_where_the_body_brakes():
    """A body that moves by jerks, once in 13 frames, comes to rest on its counts."""
    time = np.arange(390)
    ease = (time // 13) + np.clip((time % 13) / 8, 0, 1) ** 2
    places = np.zeros((len(time), 4, 3))
    places[..., 0] = ease[:, None]
    counts = find_counts(places)
    assert len(counts) > 24
    np.testing.assert_allclose(np.diff(counts), 13, atol=1.0)
    off = (counts - 8 + 6.5) % 13 - 6.5
    assert np.abs(off).max() < 2.5


def test_a_dance_of_a_second_has_no_counts():
    assert len(find_counts(np.zeros((30, 4, 3)))) == 0
