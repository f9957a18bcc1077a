import pytest

from echoavatar_lab.corpora.gesture.handshapes import COUNTS, HAND_SHAPES, count_shape, hand_shape


@pytest.mark.parametrize("name", HAND_SHAPES)
def test_shapes_stay_within_the_controls_ranges(name: str):
    shape = hand_shape(name)
    assert shape.shape == (7,)
    assert shape[:5].min() >= 0
    assert shape[:5].max() <= 1
    assert abs(shape[5]) <= 1
    assert 0 <= shape[6] <= 1


def test_counting_shows_as_many_straight_fingers():
    """A straight finger has a curl under 0.1; the thumb only counts at five."""
    straight = [int((hand_shape(name)[1:5] < 0.1).sum()) for name in (*COUNTS, "five")]
    assert straight == [1, 2, 3, 4, 4]
    assert [count_shape(word) for word in ("One", "second,", "three.", "fifty")] == ["one", "two", "three", "five"]
